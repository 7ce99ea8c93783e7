// The frame that is being labelled: its points as they are on the screen, the selection, and its edits.
// Edits are sent through `save`; the server's answers come back through `adopt`.

/** Events: "open" (another frame), "points" (anything of it changed), "selection". */
export class OpenFrame extends EventTarget {
  keypoints = [];
  frame = null; // as the server has it
  points = {};
  notVisible = new Set();
  note = "";
  flagged = false;
  skipped = false;
  /** What arrow keys move. */
  selected = null;
  /** True while points may not be changed: another frame is on its way. */
  locked = true;
  /** {keypoint: [x, y]} of the point being dragged: an answer of the server does not move it. */
  #dragged = {};
  #save;

  /** save(frame, body, merge): put an edit on its way. */
  constructor(save) {
    super();
    this.#save = save;
  }

  get isRepeat() {
    return Boolean(this.frame?.repeat);
  }

  /** Show a frame; `unsent` is the body of an edit of it that is not saved yet. */
  open(frame, keypoints, unsent = null) {
    const another = frame.id !== this.frame?.id || this.isRepeat !== Boolean(frame.repeat);
    this.keypoints = keypoints;
    if (another) this.#dragged = {};
    this.#take(frame, unsent);
    if (another || !keypoints.includes(this.selected)) {
      this.selected = this.missing()[0] ?? this.keypoints[0] ?? null;
    }
    this.locked = false;
    this.#emit("open");
  }

  close() {
    this.frame = null;
    this.points = {};
    this.notVisible.clear();
    this.locked = true;
    this.#emit("open");
  }

  /** Take over the server's state of this frame; unsent edits stay on top. */
  adopt(frame, unsent = null) {
    if (!this.frame || frame.id !== this.frame.id || this.isRepeat) return;
    const before = this.points;
    this.#take({ ...this.frame, ...frame }, unsent);
    // After an undo the point that was removed is selected, to be placed again.
    this.selected = this.keypoints.find((name) => before[name] && this.isMissing(name)) ?? this.selected;
    this.#emit("points");
  }

  isPlaced(keypoint) {
    return Boolean(this.points[keypoint]);
  }

  isMissing(keypoint) {
    return !this.points[keypoint] && !this.notVisible.has(keypoint);
  }

  missing() {
    return this.keypoints.filter((keypoint) => this.isMissing(keypoint));
  }

  /** The keypoint that a click places: the selected one, else the next that is missing. */
  get target() {
    if (this.selected && this.isMissing(this.selected)) return this.selected;
    const at = this.keypoints.indexOf(this.selected);
    const round = [...this.keypoints.slice(at + 1), ...this.keypoints.slice(0, at + 1)];
    return round.find((keypoint) => this.isMissing(keypoint)) ?? null;
  }

  select(keypoint) {
    if (keypoint === this.selected) return;
    this.selected = keypoint;
    this.#emit("selection");
  }

  selectStep(steps) {
    const count = this.keypoints.length;
    const at = this.keypoints.indexOf(this.selected);
    this.select(this.keypoints[(at + steps + count) % count]);
  }

  /** Move a point on the screen only, while it is being dragged. */
  drag(keypoint, xy) {
    if (this.locked) return;
    this.#dragged = { [keypoint]: rounded(xy) };
    this.points[keypoint] = this.#dragged[keypoint];
    this.notVisible.delete(keypoint);
    this.#emit("points");
  }

  /** End a drag; `adopt` then shows the point where it was. */
  endDrag() {
    this.#dragged = {};
  }

  /** Set points, {keypoint: [x, y]|null}, and save. `merge` as in `SaveQueue.add`. */
  set(changes, merge = null) {
    if (this.locked) return;
    this.endDrag();
    for (const [keypoint, xy] of Object.entries(changes)) {
      this.points[keypoint] = xy && rounded(xy);
      this.notVisible.delete(keypoint);
    }
    this.#changed(merge);
  }

  toggleNotVisible(keypoint) {
    if (this.locked || !keypoint || this.isRepeat) return;
    if (this.notVisible.has(keypoint)) this.notVisible.delete(keypoint);
    else {
      this.notVisible.add(keypoint);
      this.points[keypoint] = null;
    }
    this.#changed();
  }

  setNote(note) {
    if (this.locked || note === this.note) return;
    this.note = note;
    this.#changed("note");
  }

  toggleFlagged() {
    if (this.locked || this.isRepeat) return;
    this.flagged = !this.flagged;
    this.#changed();
  }

  toggleSkipped() {
    if (this.locked || this.isRepeat) return;
    this.skipped = !this.skipped;
    this.#changed();
  }

  #changed(merge = null) {
    this.#save(this.frame, this.#body(), merge);
    this.#emit("points");
  }

  #body() {
    const points = Object.fromEntries(this.keypoints.map((name) => [name, this.points[name] ?? null]));
    if (this.isRepeat) return { points };
    return {
      points,
      not_visible: this.keypoints.filter((keypoint) => this.notVisible.has(keypoint)),
      note: this.note,
      flagged: this.flagged,
      skipped: this.skipped,
    };
  }

  #take(frame, unsent) {
    const state = { points: {}, not_visible: [], note: "", flagged: false, skipped: false, ...frame, ...unsent };
    this.frame = frame;
    this.points = { ...state.points, ...this.#dragged };
    this.notVisible = new Set(state.not_visible.filter((name) => !this.#dragged[name]));
    this.note = state.note;
    this.flagged = state.flagged;
    this.skipped = state.skipped;
  }

  #emit(name) {
    this.dispatchEvent(new Event(name));
  }
}

/** Rounded to 0.01 px: finer than any labelling, and steps of 0.25 px stay exact. */
function rounded([x, y]) {
  return [Math.round(x * 100) / 100, Math.round(y * 100) / 100];
}
