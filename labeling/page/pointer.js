// Mouse, pen and touch on the stage: place, drag, pan, zoom. Positions become image positions here, edits go to
// the open frame.

const GRAB_PX = 10;
// While points are missing most clicks place one, so an existing point must be hit more exactly.
const GRAB_WHILE_PLACING_PX = 6;
const DRAG_STARTS_PX = 3;

export class Pointer extends EventTarget {
  /** Image position under the pointer, null when it is elsewhere. */
  over = null;
  /** The keypoint being dragged or placed. */
  dragged = null;
  panning = false;
  /** True while the space bar is held. */
  panKey = false;
  #root;
  #open;
  #view;
  #options;
  #gesture = null;

  constructor(root, open, view, options) {
    super();
    this.#root = root;
    this.#open = open;
    this.#view = view;
    this.#options = options;
    root.addEventListener("pointerdown", (event) => this.#down(event));
    root.addEventListener("pointermove", (event) => this.#move(event));
    root.addEventListener("pointerup", (event) => this.#up(event));
    root.addEventListener("pointercancel", (event) => this.#cancel(event));
    root.addEventListener("pointerleave", () => this.#leave());
    root.addEventListener("wheel", (event) => this.#wheel(event), { passive: false });
    root.addEventListener("contextmenu", (event) => event.preventDefault());
    root.addEventListener("auxclick", (event) => event.preventDefault());
  }

  setPanKey(held) {
    this.panKey = held;
    this.#root.classList.toggle("pannable", held);
  }

  #down(event) {
    if (event.target.closest("button, input") || this.#gesture) return;
    this.#root.focus({ preventScroll: true });
    const at = this.#position(event);
    this.#options.keyboardCursor = null;
    this.#root.setPointerCapture(event.pointerId);
    if (event.button === 1 || event.button === 2 || (event.button === 0 && this.panKey)) {
      event.preventDefault();
      this.panning = true;
      this.#root.classList.add("panning");
      this.#gesture = { kind: "pan", last: at };
    } else if (event.button === 0 && this.#open.frame && !this.#open.locked) {
      this.#press(at, event.shiftKey);
    }
    this.#changed();
  }

  #press(at, placeAnyway) {
    const target = this.#open.target;
    const near = placeAnyway && target ? null : this.#nearest(at, target ? GRAB_WHILE_PLACING_PX : GRAB_PX);
    if (near) {
      this.#open.select(near);
      const mark = this.#view.toScreen(this.#open.points[near]);
      this.#gesture = { kind: "grab", keypoint: near, start: at, offset: [mark[0] - at[0], mark[1] - at[1]] };
    } else if (target && this.#view.contains(this.#view.toImage(at))) {
      // Button down places the point, moving corrects it with the loupe, button up saves it.
      this.#gesture = { kind: "place", keypoint: target };
      this.dragged = target;
      this.#open.select(target);
      this.#open.drag(target, this.#view.toImage(at));
    } else {
      this.dispatchEvent(new CustomEvent("missed", { detail: { complete: !target } }));
    }
  }

  #move(event) {
    const at = this.#position(event);
    const gesture = this.#gesture;
    this.over = this.#view.toImage(at);
    if (this.#options.keyboardCursor && event.movementX === 0 && event.movementY === 0) return;
    this.#options.keyboardCursor = null;
    if (gesture?.kind === "pan") {
      this.#view.pan(at[0] - gesture.last[0], at[1] - gesture.last[1]);
      gesture.last = at;
    } else if (gesture?.kind === "grab") {
      const far = Math.hypot(at[0] - gesture.start[0], at[1] - gesture.start[1]);
      if (!this.dragged && far < DRAG_STARTS_PX) return;
      this.dragged = gesture.keypoint;
      const mark = [at[0] + gesture.offset[0], at[1] + gesture.offset[1]];
      this.#open.drag(gesture.keypoint, this.#view.clamped(this.#view.toImage(mark)));
    } else if (gesture?.kind === "place") {
      this.#open.drag(gesture.keypoint, this.#view.clamped(this.over));
    } else {
      const near = this.#nearest(at, this.#open.target ? GRAB_WHILE_PLACING_PX : GRAB_PX);
      this.#root.classList.toggle("grabbable", Boolean(near));
    }
    this.#changed();
  }

  #up() {
    const keypoint = this.dragged;
    this.#end();
    if (keypoint) {
      this.#open.set({ [keypoint]: this.#open.points[keypoint] });
      this.dispatchEvent(new Event("set"));
    }
    this.#changed();
  }

  /** Escape while dragging: back to where it was. */
  cancel() {
    if (!this.dragged) return false;
    this.#end();
    this.dispatchEvent(new Event("cancelled"));
    return true;
  }

  #cancel() {
    if (!this.cancel()) this.#end();
  }

  #end() {
    this.#gesture = null;
    this.dragged = null;
    this.panning = false;
    this.#root.classList.remove("panning");
  }

  #leave() {
    if (this.#gesture) return;
    this.over = null;
    this.#changed();
  }

  #wheel(event) {
    event.preventDefault();
    const lines = event.deltaMode === WheelEvent.DOM_DELTA_LINE ? 30 : 1;
    // A pinch on a touchpad arrives as a wheel with the control key, in much smaller steps.
    const speed = event.ctrlKey ? 0.01 : 0.0016;
    const factor = Math.exp(-Math.min(Math.max(event.deltaY * lines, -300), 300) * speed);
    const at = this.#position(event);
    this.#view.zoomAt(at, factor);
    this.over = this.#view.toImage(at);
    this.#changed();
  }

  #nearest(at, within) {
    let best = null;
    let least = within;
    for (const [name, xy] of Object.entries(this.#open.points)) {
      if (!xy) continue;
      const mark = this.#view.toScreen(xy);
      const distance = Math.hypot(mark[0] - at[0], mark[1] - at[1]);
      if (distance <= least) [best, least] = [name, distance];
    }
    return best;
  }

  #position(event) {
    const box = this.#root.getBoundingClientRect();
    return [event.clientX - box.left, event.clientY - box.top];
  }

  #changed() {
    this.dispatchEvent(new Event("change"));
  }
}
