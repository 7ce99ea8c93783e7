// The list of points on the right: their positions, the next one to place, and where the network disagrees.

import { byId, element } from "./elements.js";
import { swatch } from "./palette.js";

export class PointsPanel {
  #rows = [];
  #open;

  constructor(keypoints, open) {
    this.#open = open;
    keypoints.forEach((name, index) => this.#rows.push(this.#makeRow(name, index)));
    byId("points").replaceChildren(...this.#rows.map(({ item }) => item));
  }

  /** disagreements: {keypoint: px} as `scene.js` finds them. */
  update(disagreements) {
    const open = this.#open;
    const target = open.frame ? open.target : null;
    for (const { name, item, button, value } of this.#rows) {
      const xy = open.points[name];
      const asked = open.keypoints.includes(name);
      item.hidden = !asked;
      button.setAttribute("aria-pressed", name === open.selected);
      button.classList.toggle("target", name === target);
      button.classList.toggle("warning", name in disagreements);
      let text = name === target ? "next" : "–";
      if (xy) text = `${xy[0].toFixed(2)}  ${xy[1].toFixed(2)}`;
      else if (open.notVisible.has(name)) text = "not visible";
      if (name in disagreements) text = `Δ ${disagreements[name].toFixed(1)} px`;
      value.textContent = text;
      value.classList.toggle("numbers", Boolean(xy));
      button.title = xy ? `x ${xy[0].toFixed(2)}, y ${xy[1].toFixed(2)} px` : "";
    }
  }

  #makeRow(name, index) {
    const value = element("span", { class: "point-value" });
    const key = index < 9 ? element("kbd", {}, String(index + 1)) : element("span");
    const button = element(
      "button",
      { type: "button", class: "point", onclick: () => this.#open.select(name) },
      swatch(index),
      element("span", { class: "point-name" }, name),
      value,
      key,
    );
    return { name, item: element("li", {}, button), button, value };
  }
}
