// Says at every moment whether what is on the screen is on the disk.

import { byId, icon } from "./elements.js";

const edits = (count) => (count === 1 ? "1 edit" : `${count} edits`);

const WORDS = {
  saved: () => "Saved",
  saving: () => "Saving…",
  offline: ({ waiting }) => (waiting ? `Offline · ${edits(waiting)} kept, will send again` : "Offline · connecting again"),
  session: ({ waiting }) => `Signed out · ${edits(waiting)} kept here`,
  disk: ({ waiting }) => `Not on disk yet · ${edits(waiting)} kept, trying again`,
  conflict: () => "Waiting for your choice",
};

export function showSaving(status) {
  const node = byId("saving");
  const words = WORDS[status.state](status);
  if (node.dataset.state === status.state && node.textContent === words) return;
  node.dataset.state = status.state;
  const mark = status.state === "saved" ? icon("check") : status.state === "saving" ? dot() : icon("warning");
  node.replaceChildren(mark, words);
  node.title = status.reason;
}

function dot() {
  const node = document.createElement("span");
  node.className = "saving-dot";
  return node;
}
