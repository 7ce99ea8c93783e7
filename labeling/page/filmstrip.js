// The list of frames on the left: thumbnails, states, filters, progress.

import { byId, element, icon } from "./elements.js";

const FILTER_NAMES = { all: "All", todo: "To do", flagged: "Flagged", worst: "Worst" };
const FILTER_TITLES = {
  all: "All frames",
  todo: "Frames with points missing",
  flagged: "Flagged frames",
  worst: "Labelled frames on which the network disagrees most, worst first",
};
const STATE_TEXT = { unlabelled: "not labelled", partial: "points missing", labelled: "labelled", skipped: "skipped" };

export class Filmstrip {
  #list;
  #open;
  #film = byId("film");
  #filters = new Map();
  #nodes = new Map();
  #current = null;
  #keypointCount;

  /** open(id): the user wants this frame. */
  constructor(list, keypointCount, open) {
    this.#list = list;
    this.#open = open;
    this.#keypointCount = keypointCount;
    this.#makeFilters();
    list.addEventListener("list", () => this.#rebuild());
    list.addEventListener("row", ({ detail }) => this.#updateRow(detail.row));
    this.#film.addEventListener("click", (event) => {
      const node = event.target.closest("[data-id]");
      if (node) open(node.dataset.id, { keepFocus: event.detail === 0 });
    });
    this.#film.addEventListener("keydown", (event) => this.#key(event));
  }

  setCurrent(id) {
    const before = this.#nodes.get(this.#current);
    this.#current = id;
    if (!this.#nodes.has(id)) this.#rebuild();
    if (before) mark(before, false);
    const node = this.#nodes.get(id);
    if (!node) return;
    mark(node, true);
    node.scrollIntoView({ block: "nearest" });
  }

  #makeFilters() {
    for (const [name, text] of Object.entries(FILTER_NAMES)) {
      const count = element("b", { class: "numbers" });
      const button = element(
        "button",
        {
          type: "button",
          role: "radio",
          title: FILTER_TITLES[name],
          onclick: () => this.#list.setFilter(name),
        },
        count,
        element("span", {}, text),
      );
      this.#filters.set(name, { button, count });
      byId("filters").append(button);
    }
    byId("filters").addEventListener("keydown", (event) => {
      const step = { ArrowRight: 1, ArrowLeft: -1 }[event.key];
      if (!step) return;
      const names = Object.keys(FILTER_NAMES);
      const next = names[(names.indexOf(this.#list.filter) + step + names.length) % names.length];
      this.#list.setFilter(next);
      this.#filters.get(next).button.focus();
      event.preventDefault();
    });
  }

  #key(event) {
    const step = { ArrowDown: 1, ArrowUp: -1 }[event.key];
    if (!step) return;
    const id = this.#list.neighbour(this.#current, step);
    if (id) {
      this.#open(id, { keepFocus: true });
      this.#nodes.get(id)?.focus();
    }
    event.preventDefault();
    event.stopPropagation();
  }

  #rebuild() {
    const rows = this.#list.shown(this.#current);
    this.#nodes.clear();
    this.#film.replaceChildren();
    let group = null;
    for (const row of rows) {
      const name = this.#list.filter === "worst" ? null : row.video;
      if (name !== group) this.#film.append(this.#heading((group = name), row.actuator));
      const node = this.#node(row);
      this.#nodes.set(row.id, node);
      this.#film.append(node);
    }
    if (!rows.length) this.#film.append(element("p", { class: "none" }, this.#emptyText()));
    const current = this.#nodes.get(this.#current);
    if (current) {
      mark(current, true);
      current.scrollIntoView({ block: "nearest" });
    } else if (rows.length) this.#nodes.get(rows[0].id).tabIndex = 0;
    this.#updateCounts();
    this.#showModel();
  }

  /** The network's state, while it is not ready. */
  #showModel() {
    const model = this.#list.model;
    const texts = {
      loading: "The network is being loaded…",
      working: `The network predicts the frames: ${model?.done} of ${model?.total}`,
      failed: `The network cannot be used${model?.reason ? `: ${model.reason}` : "."}`,
    };
    byId("model-state").textContent = texts[model?.state] ?? "";
  }

  #emptyText() {
    if (this.#list.filter === "todo") return "Every frame is labelled.";
    if (this.#list.filter === "flagged") return "No frame is flagged. F flags the one that is open.";
    if (this.#list.filter === "worst") return "Nothing to compare yet: train a network, then its disagreements show here.";
    return "No frames.";
  }

  #heading(video, actuator) {
    const same = this.#list.rows.filter((row) => row.video === video && row.state !== "skipped");
    const done = same.filter((row) => row.state === "labelled").length;
    const name = actuator && actuator !== video && actuator !== "default" ? `${actuator} · ${video}` : video;
    const count = element("span", { class: "numbers", "data-video": video }, `${done}/${same.length}`);
    return element("div", { class: "film-heading", role: "presentation" }, element("span", { title: name }, name), count);
  }

  #node(row) {
    const node = element("div", { class: "film-frame", role: "option", tabindex: "-1", "data-id": row.id, "aria-selected": "false" });
    this.#fill(node, row);
    return node;
  }

  #fill(node, row) {
    const name = row.frame === null ? row.image : String(row.frame);
    const time = row.time_s === null || row.time_s === undefined ? "" : `${row.time_s.toFixed(2)} s`;
    node.dataset.state = row.state;
    const label = [`frame ${name}`, STATE_TEXT[row.state]];
    if (row.flagged) label.push("flagged");
    if (row.note) label.push(`note: ${row.note}`);
    node.setAttribute("aria-label", label.join(", "));
    node.title = [row.image, time, row.note].filter(Boolean).join(" · ");
    const thumb =
      node.querySelector("img") ?? element("img", { loading: "lazy", decoding: "async", alt: "", width: "72", height: "48" });
    if (thumb.getAttribute("src") !== row.thumb_url) thumb.setAttribute("src", row.thumb_url);
    const distance = row.model_px;
    node.replaceChildren(
      thumb,
      element(
        "div",
        { class: "film-text" },
        element("span", { class: "film-name numbers" }, name, row.flagged ? icon("flag", "icon flag-mark") : null),
        element("span", { class: "fine numbers" }, distance !== null && distance !== undefined ? `Δ ${distance.toFixed(1)} px` : time),
      ),
      this.#badge(row),
    );
  }

  /** A shape for each state, not only a colour. */
  #badge(row) {
    if (row.state === "labelled") return element("span", { class: "badge done" }, icon("check"));
    if (row.state === "skipped") return element("span", { class: "badge skipped" }, icon("skip"));
    if (row.state === "partial") {
      const done = row.n_placed + (row.n_not_visible ?? 0);
      return element("span", { class: "badge partial numbers" }, `${done}/${this.#keypointCount}`);
    }
    return element("span", { class: "badge open" });
  }

  #updateRow(row) {
    const node = this.#nodes.get(row.id);
    if (node) this.#fill(node, row);
    for (const count of this.#film.querySelectorAll("[data-video]")) {
      if (count.dataset.video !== row.video) continue;
      const same = this.#list.rows.filter((other) => other.video === row.video && other.state !== "skipped");
      count.textContent = `${same.filter((other) => other.state === "labelled").length}/${same.length}`;
    }
    this.#updateCounts();
  }

  #updateCounts() {
    for (const [name, { button, count }] of this.#filters) {
      count.textContent = this.#list.count(name);
      const checked = name === this.#list.filter;
      button.setAttribute("aria-checked", checked);
      button.tabIndex = checked ? 0 : -1;
    }
    const { labelled, total } = this.#list.progress;
    const bar = byId("progress");
    bar.setAttribute("aria-valuemax", total);
    bar.setAttribute("aria-valuenow", labelled);
    byId("progress-fill").style.width = `${total ? (100 * labelled) / total : 0}%`;
    byId("progress-text").textContent = `${labelled} of ${total} labelled`;
  }
}

function mark(node, current) {
  node.setAttribute("aria-selected", current);
  node.tabIndex = current ? 0 : -1;
}
