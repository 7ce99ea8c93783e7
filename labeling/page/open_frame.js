// The frame that is being labelled: its points as they are on the screen, what is selected, and every edit of it.
// Edits leave through `save`; what the server makes of them comes back through `adopt`.

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
  /** {keypoint: [x, y]} while the pointer's button is down on it: an answer that comes meanwhile leaves it there. */
  #inHand = {};
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
    if (another) this.#inHand = {};
    this.#take(frame, unsent);
    if (another || !keypoints.includes(this.selected)) {
      this.selected = this.missing()[0] ?? this.keypoints[0] ?? null;
    }
    this.locked = false;
    this.#tell("open");
  }

  close() {
    this.frame = null;
    this.points = {};
    this.notVisible.clear();
    this.locked = true;
    this.#tell("open");
  }

  /** The server's word on this frame; edits that are still on their way stay on top. */
  adopt(frame, unsent = null) {
    if (!this.frame || frame.id !== this.frame.id || this.isRepeat) return;
    const before = this.points;
    this.#take({ ...this.frame, ...frame }, unsent);
    // What was undone is what one wants to place again.
    this.selected = this.keypoints.find((name) => before[name] && this.isMissing(name)) ?? this.selected;
    this.#tell("points");
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
    this.#tell("selection");
  }

  selectStep(steps) {
    const count = this.keypoints.length;
    const at = this.keypoints.indexOf(this.selected);
    this.select(this.keypoints[(at + steps + count) % count]);
  }

  /** Move a point on the screen only, while it is being dragged. */
  drag(keypoint, xy) {
    if (this.locked) return;
    this.#inHand = { [keypoint]: rounded(xy) };
    this.points[keypoint] = this.#inHand[keypoint];
    this.notVisible.delete(keypoint);
    this.#tell("points");
  }

  /** Forget what was being dragged; `adopt` then shows it where it was. */
  letGo() {
    this.#inHand = {};
  }

  /** Set points, {keypoint: [x, y]|null}, and save. `merge` as in `SaveQueue.add`. */
  set(changes, merge = null) {
    if (this.locked) return;
    this.letGo();
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
    this.#tell("points");
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
    this.points = { ...state.points, ...this.#inHand };
    this.notVisible = new Set(state.not_visible.filter((name) => !this.#inHand[name]));
    this.note = state.note;
    this.flagged = state.flagged;
    this.skipped = state.skipped;
  }

  #tell(name) {
    this.dispatchEvent(new Event(name));
  }
}

/** To 0.01 px: finer than any hand, and quarter steps stay exact. */
function rounded([x, y]) {
  return [Math.round(x * 100) / 100, Math.round(y * 100) / 100];
}
