// How this person likes to see things, kept in the browser; and the keyboard's crosshair, which is not kept.

const KEY = "bendtrack/options";

export class Options extends EventTarget {
  loupe = true;
  ghosts = true;
  /** Picture position that the keyboard aims at, null while the pointer leads. */
  keyboardCursor = null;

  constructor() {
    super();
    Object.assign(this, JSON.parse(localStorage.getItem(KEY) ?? "{}"));
  }

  toggle(name) {
    this[name] = !this[name];
    localStorage.setItem(KEY, JSON.stringify({ loupe: this.loupe, ghosts: this.ghosts }));
    this.dispatchEvent(new Event("change"));
  }
}
