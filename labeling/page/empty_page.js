// The page without frames: there are none, or the server cannot be reached.

import { byId, element } from "./elements.js";

/** A heading, a sentence, and a command to type; `main` is hidden. */
export function showEmpty(heading, text, command) {
  document.querySelector("main").hidden = true;
  const node = byId("empty");
  node.hidden = false;
  node.replaceChildren(
    element("h2", {}, heading),
    element("p", {}, text),
    element("code", {}, command),
  );
}

export function hideEmpty() {
  document.querySelector("main").hidden = false;
  byId("empty").hidden = true;
}
