// The message at the foot of the image, which disappears after a while, and the banner, which stays.

import { byId, element } from "./elements.js";

let timer = null;

export function showMessage(text, lastsMs = 4000) {
  const node = byId("message");
  clearTimeout(timer);
  node.textContent = text;
  node.hidden = !text;
  timer = setTimeout(() => (node.hidden = true), lastsMs);
}

/** A line over the header, with buttons [{text, key, run, main}]; null removes it. */
export function setBanner(text, buttons = [], kind = "note") {
  const node = byId("banner");
  node.hidden = !text;
  node.dataset.kind = kind;
  if (!text) return node.replaceChildren();
  return node.replaceChildren(
    element("span", {}, text),
    ...buttons.map(({ text: label, key, run, main }) =>
      element("button", { type: "button", class: main ? "main" : "", onclick: run }, label, key && element("kbd", {}, key)),
    ),
  );
}
