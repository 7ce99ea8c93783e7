// The save indicator: whether everything on the screen is saved on disk.

import { byId, icon } from "./elements.js";

const edits = (count) => (count === 1 ? "1 edit" : `${count} edits`);

const TEXT = {
  saved: () => "Saved",
  saving: () => "Saving…",
  offline: ({ waiting }) => (waiting ? `Offline · ${edits(waiting)} kept, will send again` : "Offline · connecting again"),
  session: ({ waiting }) => (waiting ? `Signed out · ${edits(waiting)} kept here` : "Signed out"),
  disk: ({ waiting }) => (waiting ? `Not on disk yet · ${edits(waiting)} kept, trying again` : "The project cannot be read"),
  refused: ({ waiting }) => `Not saved · ${edits(waiting)} refused, kept here`,
  conflict: () => "Waiting for your choice",
};

export function showSaving(status) {
  const node = byId("saving");
  const text = TEXT[status.state](status);
  if (node.dataset.state === status.state && node.textContent === text) return;
  node.dataset.state = status.state;
  const mark = status.state === "saved" ? icon("check") : status.state === "saving" ? dot() : icon("warning");
  node.replaceChildren(mark, text);
  node.title = status.reason;
}

function dot() {
  const node = document.createElement("span");
  node.className = "saving-dot";
  return node;
}
