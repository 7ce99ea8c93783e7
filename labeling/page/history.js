// Undo and redo. The history itself is kept by the server; here one step at a time is asked for, once everything
// that was done before has been saved.

import { Refused, Unreachable, send } from "./api.js";

export class History {
  #queue;
  #clientId;
  #busy = false;
  #own = new Set();

  constructor(queue, clientId) {
    this.#queue = queue;
    this.#clientId = clientId;
  }

  isOwn(editId) {
    return this.#own.has(editId);
  }

  /** way: "undo" or "redo". Gives {frame, words}: the frame it concerned, or null, and what to tell the user. */
  async step(way) {
    if (this.#busy) return { frame: null, words: "" };
    this.#busy = true;
    try {
      if (!(await this.#queue.drained())) {
        return { frame: null, words: `${way === "undo" ? "Undo" : "Redo"} works again once everything is saved.` };
      }
      const editId = crypto.randomUUID();
      this.#own.add(editId);
      const answer = await send("POST", `/api/${way}`, { client_id: this.#clientId, edit_id: editId });
      if (!answer) return { frame: null, words: `Nothing left to ${way}.` };
      return { frame: answer.frame, words: "" };
    } catch (error) {
      if (error instanceof Refused && error.status === 409) {
        return { frame: error.body.frame, words: "Someone else has changed this frame since; that step is passed over." };
      }
      if (error instanceof Unreachable) {
        this.#queue.setConnected(false);
        return { frame: null, words: "The server does not answer; nothing was undone." };
      }
      return { frame: null, words: error.message };
    } finally {
      this.#busy = false;
    }
  }
}
