// The user's display options, kept in the browser; and the keyboard's crosshair, which is not kept.

const KEY = "bendtrack/options";

export class Options extends EventTarget {
  loupe;
  suggestions;
  /** Image position of the keyboard's crosshair, null while the pointer is used. */
  keyboardCursor = null;

  constructor() {
    super();
    // "ghosts" is the suggestions' name in options stored by earlier versions.
    const { loupe = true, ghosts = true } = JSON.parse(localStorage.getItem(KEY) ?? "{}");
    this.loupe = loupe;
    this.suggestions = ghosts;
  }

  toggle(name) {
    this[name] = !this[name];
    localStorage.setItem(KEY, JSON.stringify({ loupe: this.loupe, ghosts: this.suggestions }));
    this.dispatchEvent(new Event("change"));
  }
}
