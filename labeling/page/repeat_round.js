// Blind repeats: labelled frames are shown again without their points. The distance between second and first labels
// gives the labeller's repeatability. The first labels are neither fetched nor shown meanwhile.

import { get } from "./api.js";
import { byId } from "./elements.js";
import { showMessage, setBanner } from "./message.js";

export class RepeatRound {
  active = false;
  #spread = null;
  #frameNavigator;
  #open;
  #queue;
  #cache;
  #stage;
  #finished;
  #done = 0;

  /** finished(spread|null): called at the end of the round. */
  constructor({ frameNavigator, open, queue, cache, stage, finished }) {
    this.#frameNavigator = frameNavigator;
    this.#open = open;
    this.#queue = queue;
    this.#cache = cache;
    this.#stage = stage;
    this.#finished = finished;
    queue.addEventListener("saved", ({ detail }) => {
      if (detail.edit.kind === "repeat") this.#spread = detail.answer.spread;
    });
  }

  /** Start, or go on with the next frame. */
  async next() {
    let frame = null;
    try {
      frame = await get("/api/repeats/next");
      if (frame) this.#stage.show(await this.#cache.get(frame.image_url));
    } catch (error) {
      showMessage(error.message);
      return this.leave();
    }
    if (!frame) {
      if (!this.active) showMessage("No frame is due for a repeat yet: label some more first.");
      return this.leave();
    }
    this.active = true;
    this.#frameNavigator.leave();
    document.body.classList.add("repeating");
    this.#open.open({ ...frame, repeat: true, revision: null }, frame.keypoints);
    setBanner(
      "Blind repeat: label this frame as if for the first time. Your earlier points are hidden.",
      [
        { text: "Save and next", key: "⏎", run: () => this.submit(), main: true },
        { text: "Leave", key: "Esc", run: () => this.leave() },
      ],
      "repeat",
    );
    return undefined;
  }

  async submit() {
    const missing = this.#open.missing();
    if (missing.length) return showMessage(`Still to place: ${missing.join(", ")}. Leave with Esc if it cannot be seen.`);
    const { frame, points } = this.#open;
    this.#queue.add({
      kind: "repeat",
      id: `repeat ${frame.id}`,
      url: frame.put_url,
      body: { points: Object.fromEntries(frame.keypoints.map((name) => [name, points[name]])) },
      base_revision: 0,
    });
    this.#done++;
    // The next one is known only when this one is on disk.
    if (await this.#queue.drained()) return this.next();
    return this.leave();
  }

  leave() {
    if (!this.active) return;
    this.active = false;
    document.body.classList.remove("repeating");
    setBanner(null);
    byId("stage").focus({ preventScroll: true });
    this.#finished(this.#done ? this.#spread : null);
    this.#done = 0;
  }
}
