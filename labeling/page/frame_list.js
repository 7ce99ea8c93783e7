// The project's frames in the order of the filmstrip: their states, filters, and what comes next.

export const FILTERS = {
  all: () => true,
  todo: (row) => isToDo(row),
  flagged: (row) => row.flagged,
  worst: (row) => row.model_px !== null,
};

function isToDo(row) {
  return row.state === "unlabelled" || row.state === "partial";
}

/** Events: "list" (rows or filter changed), "row" {row}. */
export class FrameList extends EventTarget {
  rows = [];
  filter = "all";
  repeats = { due: 0, done: 0, target: 0 };
  model = null;
  #byId = new Map();

  load({ frames, repeats, model }) {
    this.rows = frames;
    this.repeats = repeats;
    this.model = model;
    this.#byId = new Map(frames.map((row) => [row.id, row]));
    this.dispatchEvent(new Event("list"));
  }

  get(id) {
    return this.#byId.get(id) ?? null;
  }

  /** A frame object of the server, whole or as a row. */
  update(frame) {
    const row = this.#byId.get(frame.id);
    if (!row) return;
    Object.assign(row, frame);
    this.dispatchEvent(new CustomEvent("row", { detail: { row } }));
  }

  setFilter(name) {
    this.filter = name;
    this.dispatchEvent(new Event("list"));
  }

  /** Rows that the filter shows, and the current one, so that the open frame does not disappear. */
  shown(current = null) {
    const rows = this.rows.filter((row) => FILTERS[this.filter](row) || row.id === current);
    return this.filter === "worst" ? rows.sort((a, b) => (b.model_px ?? -1) - (a.model_px ?? -1)) : rows;
  }

  count(filter) {
    return this.rows.filter(FILTERS[filter]).length;
  }

  get progress() {
    const counted = this.rows.filter((row) => row.state !== "skipped");
    return { labelled: counted.filter((row) => row.state === "labelled").length, total: counted.length };
  }

  /** The shown frame `steps` away from one, or null at the end. */
  neighbour(id, steps) {
    const rows = this.shown(id);
    return rows[rows.findIndex((row) => row.id === id) + steps]?.id ?? null;
  }

  /** The next frame to label, from the end on to the start; null when all are done. */
  nextToDo(id) {
    const at = this.rows.findIndex((row) => row.id === id);
    const round = [...this.rows.slice(at + 1), ...this.rows.slice(0, at + 1)];
    return round.find((row) => isToDo(row) && row.id !== id)?.id ?? null;
  }
}
