// Frame navigation: opening a frame with its image, going to the next one, and updating it when the server changes it.

import { Refused, Unproven, Unreachable, get } from "./api.js";
import { byId } from "./elements.js";
import { showMessage } from "./message.js";

const NEIGHBOURS = [1, 2, -1, 3];
const LOADING_AFTER_MS = 180;

export class FrameNavigator {
  /** The id of the frame that is open or on its way. */
  current = null;
  #project;
  #list;
  #open;
  #queue;
  #cache;
  #stage;
  #filmstrip;
  #attempt = 0;

  constructor({ project, list, open, queue, cache, stage, filmstrip }) {
    this.#project = project;
    this.#list = list;
    this.#open = open;
    this.#queue = queue;
    this.#cache = cache;
    this.#stage = stage;
    this.#filmstrip = filmstrip;
  }

  /** Open a frame. One that is open already stays usable meanwhile. */
  async go(id) {
    const row = this.#list.get(id);
    if (!row) return;
    this.#queue.release();
    if (id === this.#open.frame?.id && !this.#open.locked && !this.#open.isRepeat) return this.refresh(id);
    const attempt = ++this.#attempt;
    const asked = performance.now();
    this.current = id;
    this.#open.locked = true;
    this.#filmstrip.setCurrent(id);
    const slow = setTimeout(() => (byId("loading").hidden = false), LOADING_AFTER_MS);
    try {
      const image = this.#cache.get(row.image_url);
      const [frame, bitmap] = await Promise.all([this.#fetched(row), image]);
      if (attempt !== this.#attempt) return;
      this.#stage.show(bitmap);
      this.#open.open(frame, this.#project.keypoints, this.#queue.latest(id)?.body);
      byId("stage").dataset.frame = id;
      byId("stage").setAttribute("aria-label", `Image of frame ${row.frame ?? row.image}`);
      history.replaceState(null, "", `#${encodeURIComponent(id)}`);
      document.title = `${row.frame ?? row.image} · ${this.#project.name} · bendtrack`;
      performance.measure("frame opened", { start: asked });
      this.#prefetch(frame);
    } catch (error) {
      if (attempt !== this.#attempt) return;
      this.#stage.clear();
      this.#open.close();
      showMessage(this.#errorText(error, row), 15000);
    } finally {
      clearTimeout(slow);
      if (attempt === this.#attempt) byId("loading").hidden = true;
    }
  }

  /** The frame `steps` on in the filmstrip. */
  step(steps) {
    const id = this.#list.neighbour(this.current, steps);
    if (id) this.go(id);
    else showMessage(steps > 0 ? "This is the last frame." : "This is the first frame.");
  }

  /** Show a frame that came with an answer, opening it where it is another one. */
  async show(frame) {
    this.#list.update(frame);
    if (frame.id === this.#open.frame?.id) this.#open.adopt(frame, this.#queue.latest(frame.id)?.body);
    else await this.go(frame.id);
  }

  /** Something outside this tab changed a frame. */
  async refresh(id) {
    const row = this.#list.get(id);
    if (!row) return;
    try {
      const frame = await this.#latest(row);
      this.#list.update(frame);
      const unsent = this.#queue.latest(id);
      const changed = frame.revision !== this.#open.frame?.revision;
      if (id !== this.#open.frame?.id || this.#open.isRepeat) return;
      this.#open.adopt(frame, unsent?.body);
      if (changed && !unsent) showMessage("Changed in another tab, or by someone else.");
    } catch (error) {
      if (![Unreachable, Refused, Unproven].some((kind) => error instanceof kind)) throw error;
    }
  }

  /** Fetch the open frame again, for its suggestions. */
  async refreshSuggestions() {
    const row = this.#list.get(this.#open.frame?.id);
    if (!row || this.#open.isRepeat) return;
    const frame = await this.#latest(row).catch(() => null);
    if (frame) this.#open.adopt(frame, this.#queue.latest(frame.id)?.body);
  }

  /** Cancel opening a frame: something else is shown. */
  leave() {
    this.#attempt++;
    byId("loading").hidden = true;
  }

  /** A frame object; from the list while the server or the project is unreachable, so that labelling can continue. */
  async #fetched(row) {
    try {
      const frame = await this.#latest(row);
      this.#list.update(frame);
      return frame;
    } catch (error) {
      const away = error instanceof Unreachable || error instanceof Unproven || error.status === 503;
      if (!away || !row.points) throw error;
      return { suggestions: {}, suggestion_source: null, previous: null, prefetch: [], ...row };
    }
  }

  #latest(row) {
    return this.#queue.undisturbed(() => get(row.url));
  }

  #prefetch(frame) {
    const near = NEIGHBOURS.map((steps) => this.#list.neighbour(frame.id, steps)).filter(Boolean);
    const todo = this.#list.nextToDo(frame.id);
    const addresses = [...near, ...(todo ? [todo] : [])].map((id) => this.#list.get(id).image_url);
    this.#cache.prefetch([...new Set([...addresses.slice(0, 2), ...(frame.prefetch ?? []), ...addresses])]);
  }

  #errorText(error, row) {
    if (error instanceof Unreachable) return "The server does not answer; this frame opens when it is back.";
    if (error instanceof Refused && error.status === 404) return `${row.id} is no longer there.`;
    if (error instanceof Refused) return error.message;
    return `${row.image}: ${error.message}`;
  }
}
