// What is shown instead of frames when there are none, or when the server cannot be reached.

import { byId, element } from "./elements.js";

/** A heading, a sentence, and a command to type; `main` is hidden. */
export function showEmpty(heading, words, command) {
  document.querySelector("main").hidden = true;
  const node = byId("empty");
  node.hidden = false;
  node.replaceChildren(
    element("h2", {}, heading),
    element("p", {}, words),
    element("code", {}, command),
  );
}

export function hideEmpty() {
  document.querySelector("main").hidden = false;
  byId("empty").hidden = true;
}
