// Brightness, contrast and gamma of what is shown, never of what is stored. One table in an SVG filter does all
// three at once, on the visible pixels only, so a slider answers at once on a 4K frame too.

import { byId } from "./elements.js";

const STEPS = 64;
export const NEUTRAL = { brightness: 0, contrast: 0, gamma: 1 };

export class Tone extends EventTarget {
  settings = { ...NEUTRAL };

  get isNeutral() {
    return Object.keys(NEUTRAL).every((name) => this.settings[name] === NEUTRAL[name]);
  }

  set(changes) {
    Object.assign(this.settings, changes);
    const table = Array.from({ length: STEPS }, (_, i) => toned(i / (STEPS - 1), this.settings).toFixed(4));
    for (const channel of byId("tone").querySelectorAll("feFuncR, feFuncG, feFuncB")) {
      channel.setAttribute("tableValues", table.join(" "));
    }
    for (const canvas of document.querySelectorAll(".image")) canvas.classList.toggle("toned", !this.isNeutral);
    this.dispatchEvent(new Event("change"));
  }
}

/** A level in [0, 1]: gamma lifts the dark, contrast turns about the middle, brightness shifts. */
function toned(level, { brightness, contrast, gamma }) {
  const slope = contrast < 0 ? 1 + contrast : 1 / (1 - 0.95 * contrast);
  const value = (level ** (1 / gamma) - 0.5) * slope + 0.5 + brightness / 2;
  return Math.min(Math.max(value, 0), 1);
}
