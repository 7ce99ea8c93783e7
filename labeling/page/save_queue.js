// Queue of edits that are not saved yet. Each is written to localStorage before it is sent and removed once the server
// has it on disk, so neither a killed server nor a reloaded page loses one. One is sent at a time, in order.
//
// An edit keeps its `edit_id` however often it is sent; the server does it once. An edit made on top of an earlier,
// unsent one of the same frame has no base revision of its own: it follows the earlier one's answer.
//
// No edit leaves the queue unless the server has it, a later edit of the same frame contains it, or the user drops it.
// One that the server refuses holds back only the later ones of its frame; it is sent again from time to time.

import { Refused, Unproven, Unreachable } from "./api.js";

const RETRY_MS = [300, 600, 1200, 2500, 5000];
const REFUSED_AGAIN_MS = 5000;
// Refusals that concern one edit. After any other failure all edits wait.
const REFUSED_STATUS = new Set([400, 404, 405, 409, 413, 415, 422]);

/** Events: "status" (see `status`), "saved" {edit, answer}, "conflict" {id}. */
export class SaveQueue extends EventTarget {
  #key;
  #send;
  #savedCount = 0;
  #edits = [];
  #held = new Set(); // edit ids that wait for more of the same, e.g. a key that repeats
  #conflicts = new Map(); // frame id -> the frame as somebody else left it
  #refused = new Map(); // frame id -> {reason, waits}: why its first edit was refused, and whether it waits
  #refusedTimer = null;
  #sending = null;
  #failures = 0;
  #retryTimer = null;
  #trouble = null; // null, or {kind: "offline"|"session"|"disk", reason}
  #idle = [];
  #own = new Set();

  /** key: where in localStorage; send: async (edit) => the server's answer. */
  constructor(key, send) {
    super();
    this.#key = key;
    this.#send = send;
    this.#edits = stored(key);
  }

  get status() {
    const state = this.#conflicts.size
      ? "conflict"
      : (this.#trouble?.kind ?? (this.#refused.size ? "refused" : this.#edits.length ? "saving" : "saved"));
    const [refusal] = this.#refused.values();
    return { state, waiting: this.#edits.length, reason: this.#trouble?.reason ?? refusal?.reason ?? "" };
  }

  /** Whether an edit of a server event was made here. */
  isOwn(editId) {
    return this.#own.has(editId);
  }

  /** The last unsent edit of a frame, what its content will be. */
  latest(id) {
    return this.#edits.findLast((edit) => edit.id === id) ?? null;
  }

  conflict(id) {
    return this.#conflicts.get(id) ?? null;
  }

  /** Ids of the frames whose edits the server refuses. */
  get refused() {
    return [...this.#refused.keys()];
  }

  get conflicts() {
    return [...this.#conflicts.keys()];
  }

  /** Result of `fetch`, repeated where an edit was saved in between: the answer is never older than a saved edit. */
  async undisturbed(fetch) {
    for (;;) {
      const count = this.#savedCount;
      const answer = await fetch();
      if (count === this.#savedCount) return answer;
    }
  }

  /** Edits that an earlier tab left behind go first. */
  adopt(edits) {
    this.#edits.unshift(...edits.filter((edit) => !this.#edits.some((own) => own.edit_id === edit.edit_id)));
    this.#store();
    this.#run();
  }

  /** edit: {id, url, kind, body, base_revision}. With a `merge` key it waits for `release`, and takes the place
   *  of the edit with the same key that is waiting. */
  add(edit, merge = null) {
    const last = this.latest(edit.id);
    if (last && this.#refused.has(edit.id)) return this.#supersede(edit);
    if (last && merge && last.merge === merge && this.#held.has(last.edit_id)) {
      last.body = edit.body;
    } else {
      this.release();
      // Behind an unsent edit the base is that edit's outcome, not known yet.
      const base = last ? null : edit.base_revision;
      const added = { ...edit, edit_id: crypto.randomUUID(), base_revision: base, merge };
      this.#edits.push(added);
      if (merge) this.#held.add(added.edit_id);
    }
    this.#store();
    this.#run();
  }

  /** Send what was held back. */
  release() {
    if (!this.#held.size) return;
    this.#held.clear();
    this.#run();
  }

  /** The connection was seen to work, or to fail. */
  setConnected(connected) {
    if (connected) this.retry();
    else if (!this.#trouble) this.#setTrouble({ kind: "offline", reason: "" });
  }

  retry() {
    this.#failures = 0;
    for (const refusal of this.#refused.values()) refusal.waits = false;
    clearTimeout(this.#refusedTimer);
    this.#refusedTimer = null;
    clearTimeout(this.#retryTimer);
    this.#retryTimer = null;
    if (!this.#edits.length) this.#setTrouble(null);
    this.#run();
  }

  /** Resolves true when all is saved, false when it cannot be just now. */
  drained() {
    this.release();
    if (!this.#edits.length) return Promise.resolve(true);
    if (this.#trouble || this.#conflicts.size || this.#refused.size) return Promise.resolve(false);
    return new Promise((resolve) => this.#idle.push(resolve));
  }

  /** Settle a conflict: my last version replaces theirs. */
  keepMine(id) {
    const theirs = this.#conflicts.get(id);
    const mine = this.latest(id);
    const settled = { ...mine, edit_id: crypto.randomUUID(), base_revision: theirs.revision };
    this.#replaceEditsOf(id, settled);
  }

  /** Settle a conflict: their version stays, my unsent edits of the frame are dropped. */
  takeTheirs(id) {
    this.#replaceEditsOf(id, null);
  }

  /** The user gives up the edits that the server refuses. */
  dropRefused() {
    for (const id of this.refused) this.#replaceEditsOf(id, null);
  }

  /** A later edit of a frame has all of the frame in it, and may be what the server can accept. */
  #supersede(edit) {
    const { base_revision: base } = this.#edits.find((earlier) => earlier.id === edit.id);
    this.#replaceEditsOf(edit.id, { ...edit, edit_id: crypto.randomUUID(), base_revision: base, merge: null });
  }

  #replaceEditsOf(id, settled) {
    this.#edits = this.#edits.filter((edit) => edit.id !== id);
    if (settled) this.#edits.push(settled);
    this.#conflicts.delete(id);
    this.#refused.delete(id);
    this.#store();
    this.#emit("status");
    this.#run();
  }

  async #run() {
    this.#emit("status");
    if (this.#sending || this.#retryTimer) return;
    for (let edit = this.#next(); edit; edit = this.#next()) {
      this.#sending = edit;
      this.#own.add(edit.edit_id);
      try {
        const answer = await this.#send(edit);
        this.#failures = 0;
        this.#trouble = null;
        this.#done(edit, answer);
      } catch (error) {
        if (!this.#failed(edit, error)) break;
      } finally {
        this.#sending = null;
      }
    }
    this.#emit("status");
    if (!this.#edits.length || this.#trouble || this.#conflicts.size || this.#refused.size) {
      this.#settleIdle(!this.#edits.length);
    }
  }

  #next() {
    // Held edits stop only what comes behind them on the same frame, which is nothing: `add` releases them.
    const waits = ({ id, edit_id: editId }) => this.#held.has(editId) || this.#conflicts.has(id) || this.#refused.get(id)?.waits;
    return this.#edits.find((edit) => !waits(edit));
  }

  #done(edit, answer) {
    this.#savedCount++;
    this.#refused.delete(edit.id);
    this.#edits = this.#edits.filter((other) => other !== edit);
    const following = this.#edits.find((other) => other.id === edit.id);
    if (following && following.base_revision === null) {
      // An edit that is sent again after a crash may find that someone changed the frame after it. Then the next edit
      // was based on a state that no longer exists.
      if (edit.kind !== "frame" || holds(answer, edit.body)) following.base_revision = answer?.revision ?? 0;
      else this.#conflicts.set(edit.id, answer);
    }
    this.#store();
    this.#emit("saved", { edit, answer });
    if (this.#conflicts.has(edit.id)) this.#emit("conflict", { id: edit.id });
  }

  /** True: go on with the next edit. */
  #failed(edit, error) {
    if (error instanceof Refused && REFUSED_STATUS.has(error.status)) this.#trouble = null;
    if (error instanceof Refused && error.status === 409 && error.body?.frame) {
      this.#refused.delete(edit.id);
      this.#conflicts.set(edit.id, error.body.frame);
      this.#emit("conflict", { id: edit.id });
      return true;
    }
    if (error instanceof Refused && REFUSED_STATUS.has(error.status)) {
      const later = edit.kind === "frame" && this.#edits.find((other) => other !== edit && other.id === edit.id);
      if (later) {
        // It has all of the frame in it, and may be what the server can accept.
        later.base_revision ??= edit.base_revision;
        this.#edits = this.#edits.filter((other) => other !== edit);
        this.#store();
        return true;
      }
      this.#refused.set(edit.id, { reason: error.status === 404 ? "the frame is not there" : error.message, waits: true });
      this.#refusedTimer ??= setTimeout(() => this.retry(), REFUSED_AGAIN_MS);
      return true;
    }
    if (![Refused, Unproven, Unreachable].some((kind) => error instanceof kind)) console.error(error);
    this.#setTrouble({ kind: kindOf(error), reason: error.message });
    const wait = RETRY_MS[Math.min(this.#failures++, RETRY_MS.length - 1)];
    this.#retryTimer = setTimeout(() => {
      this.#retryTimer = null;
      this.#run();
    }, wait);
    return false;
  }

  #setTrouble(trouble) {
    this.#trouble = trouble;
    this.#emit("status");
    if (trouble) this.#settleIdle(false);
  }

  #settleIdle(saved) {
    for (const resolve of this.#idle.splice(0)) resolve(saved);
  }

  #store() {
    try {
      if (this.#edits.length) localStorage.setItem(this.#key, JSON.stringify(this.#edits));
      else localStorage.removeItem(this.#key);
    } catch (error) {
      console.warn("edits are not kept over a reload:", error);
    }
  }

  #emit(name, detail) {
    this.dispatchEvent(new CustomEvent(name, { detail }));
  }
}

function kindOf(error) {
  if (error instanceof Unproven) return "session";
  return error instanceof Refused ? "disk" : "offline";
}

/** Edits kept under a key of localStorage. */
export function stored(key) {
  try {
    return JSON.parse(localStorage.getItem(key)) ?? [];
  } catch {
    return [];
  }
}

/** Whether a frame's content is what an edit asked for (positions are kept to 0.001 px). */
function holds(frame, body) {
  const same = (a, b) => (a && b ? Math.hypot(a[0] - b[0], a[1] - b[1]) < 0.002 : !a === !b);
  return (
    Object.entries(body.points ?? {}).every(([name, xy]) => same(xy, frame.points[name])) &&
    (body.not_visible ?? frame.not_visible).slice().sort().join() === frame.not_visible.slice().sort().join() &&
    (body.note ?? frame.note) === frame.note &&
    (body.flagged ?? frame.flagged) === frame.flagged &&
    (body.skipped ?? frame.skipped) === frame.skipped
  );
}
