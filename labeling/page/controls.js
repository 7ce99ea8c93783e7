// The buttons, sliders and the note field, connected to actions.

import { byId } from "./elements.js";
import { NEUTRAL } from "./tone.js";

const BUTTONS = {
  undo: "undo",
  redo: "redo",
  "next-todo": "nextToDo",
  "repeats-due": "repeats",
  "open-summary": "summary",
  "open-help": "help",
  fit: "fit",
  "toggle-loupe": "loupe",
  "toggle-suggestions": "suggestions",
  "copy-previous": "copyPrevious",
  "accept-suggestions": "acceptSuggestions",
  "not-visible": "notVisible",
  flag: "flag",
  skip: "skip",
};
const NOTE_PAUSE_MS = 700;

export function connectControls({ actions, open, queue, tone, options }) {
  for (const [id, name] of Object.entries(BUTTONS)) byId(id).addEventListener("click", () => actions[name]());
  // A click with the mouse returns the keyboard focus to the image; a click by keyboard leaves it on the control.
  document.addEventListener("click", (event) => {
    const control = event.target.closest("button, [role=option]");
    if (control && event.detail > 0 && !document.querySelector("dialog[open]")) {
      byId("stage").focus({ preventScroll: true });
    }
  });
  for (const dialog of document.querySelectorAll("dialog")) {
    dialog.addEventListener("click", (event) => {
      if (event.target === dialog && dialog.id !== "conflict") dialog.close();
    });
    dialog.addEventListener("close", () => byId("stage").focus({ preventScroll: true }));
  }
  connectNote(open, queue);
  connectTone(tone);
  const showOptions = () => {
    byId("toggle-loupe").setAttribute("aria-pressed", options.loupe);
    byId("toggle-suggestions").setAttribute("aria-pressed", options.suggestions);
  };
  options.addEventListener("change", showOptions);
  showOptions();
}

function connectNote(open, queue) {
  const note = byId("note");
  let timer = null;
  note.addEventListener("input", () => {
    open.setNote(note.value);
    clearTimeout(timer);
    timer = setTimeout(() => queue.release(), NOTE_PAUSE_MS);
  });
  note.addEventListener("blur", () => queue.release());
}

function connectTone(tone) {
  for (const name of Object.keys(NEUTRAL)) {
    const slider = byId(name);
    // Gamma is even about 1 on a logarithmic slider, 1/4 to 4.
    slider.addEventListener("input", () => {
      const value = Number(slider.value);
      tone.set({ [name]: name === "gamma" ? 4 ** value : value });
    });
  }
  tone.addEventListener("change", () => (byId("tone-reset").hidden = tone.isNeutral));
  byId("tone-reset").addEventListener("click", () => {
    for (const name of Object.keys(NEUTRAL)) byId(name).value = 0;
    tone.set(NEUTRAL);
  });
}
