// Undo and redo. The server keeps the history; the page requests one step at a time, once all earlier edits are saved.

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

  /** way: "undo" or "redo". Gives {frame, text}: the frame it concerned, or null, and what to tell the user. */
  async step(way) {
    if (this.#busy) return { frame: null, text: "" };
    this.#busy = true;
    try {
      if (!(await this.#queue.drained())) {
        return { frame: null, text: `${way === "undo" ? "Undo" : "Redo"} works again once everything is saved.` };
      }
      const editId = crypto.randomUUID();
      this.#own.add(editId);
      const answer = await send("POST", `/api/${way}`, { client_id: this.#clientId, edit_id: editId });
      if (!answer) return { frame: null, text: `Nothing left to ${way}.` };
      return { frame: answer.frame, text: "" };
    } catch (error) {
      if (error instanceof Refused && error.status === 409) {
        return { frame: error.body.frame, text: "Someone else has changed this frame since; that step is skipped." };
      }
      if (error instanceof Unreachable) {
        this.#queue.setConnected(false);
        return { frame: null, text: "The server does not answer; nothing was undone." };
      }
      return { frame: null, text: error.message };
    } finally {
      this.#busy = false;
    }
  }
}
