// One line at the foot of the picture for what just happened, gone after a while; and the banner for what lasts.

import { byId, element } from "./elements.js";

let timer = null;

export function say(words, lastsMs = 4000) {
  const node = byId("message");
  clearTimeout(timer);
  node.textContent = words;
  node.hidden = !words;
  timer = setTimeout(() => (node.hidden = true), lastsMs);
}

/** A line across the page, with buttons [{words, key, run, main}]; null takes it away. */
export function setBanner(words, buttons = [], kind = "note") {
  const node = byId("banner");
  node.hidden = !words;
  node.dataset.kind = kind;
  if (!words) return node.replaceChildren();
  return node.replaceChildren(
    element("span", {}, words),
    ...buttons.map(({ words: label, key, run, main }) =>
      element("button", { type: "button", class: main ? "main" : "", onclick: run }, label, element("kbd", {}, key)),
    ),
  );
}
