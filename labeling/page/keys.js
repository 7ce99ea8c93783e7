// All keys of the page, in one table: their actions and their help. Single letters are ignored while text is being
// written or a dialog is open.

import { byId, element } from "./elements.js";

const MOD = /Mac/.test(navigator.platform) ? "⌘" : "Ctrl";
const ARROWS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };

/** [group, [[keys, text, action name, argument]]]; `keys` as `pressed` spells them. */
const TABLE = [
  [
    "Points",
    [
      [["click"], "place the next point; keep the button down to correct it"],
      [["drag"], "move a point"],
      [["arrows"], "move the selected point by 0.25 px, or the crosshair"],
      [["shift+arrows"], "by 1 px"],
      [["alt+arrows"], "by a big step"],
      [["enter"], "place at the crosshair, then go to the next point", "enter"],
      [["w", "s"], "select the point before, after"],
      [["1–9"], "select a point"],
      [["x"], "not visible", "notVisible"],
      [["backspace", "delete"], "remove the point", "remove"],
      [["c"], "copy the previous frame's points (Shift: over placed ones too)", "copyPrevious"],
      [["g"], "accept all suggestions (Shift: over placed ones too)", "acceptSuggestions"],
      [["z"], `undo (${MOD}+Z too)`, "undo"],
      [["shift+z"], "redo", "redo"],
    ],
  ],
  [
    "Frames",
    [
      [["d", "pagedown"], "next frame", "step", 1],
      [["a", "pageup"], "frame before", "step", -1],
      [["n"], "next frame to label", "nextToDo"],
      [["f"], "flag", "flag"],
      [["k"], "skip: leave this frame out", "skip"],
      [["m"], "write a note (Esc ends it)", "note"],
      [["v"], "next filter", "filter"],
      [["i"], "how good the labels are", "summary"],
      [["r"], "blind repeats", "repeats"],
    ],
  ],
  [
    "View",
    [
      [["wheel"], "zoom about the pointer"],
      [["+", "−"], "zoom about the crosshair or the selected point"],
      [["space+drag"], "pan; the middle button too"],
      [["0"], "fit the image", "fit"],
      [["l"], "loupe", "loupe"],
      [["h"], "suggestions", "suggestions"],
      [["esc"], "let go; close", "escape"],
      [["?"], "this list", "help"],
    ],
  ],
];

// Keys that are not in the help, or are there under another name.
const MORE = {
  w: ["select", -1],
  s: ["select", 1],
  "shift+c": ["copyPrevious", true],
  "shift+g": ["acceptSuggestions", true],
  "mod+z": ["undo"],
  "mod+shift+z": ["redo"],
  "mod+y": ["redo"],
  "+": ["zoom", 1.5],
  "=": ["zoom", 1.5],
  "-": ["zoom", 1 / 1.5],
  escape: ["escape"],
};

/** actions: {name: (argument) => ...}; plus nudge(direction, size), number(n), panKey(held), released(). */
export function listenToKeys(actions) {
  const bindings = new Map(Object.entries(MORE));
  for (const [, lines] of TABLE) {
    for (const [keys, , name, argument] of lines) if (name) for (const key of keys) bindings.set(key, [name, argument]);
  }
  addEventListener("keydown", (event) => {
    if (document.querySelector("dialog[open]") || event.isComposing) return;
    const writing = event.target.closest("textarea, input:not([type=range])");
    if (writing) {
      if (event.key === "Escape") byId("stage").focus();
      return;
    }
    // On a control these keys are the control's own.
    const control = event.target.closest("button, input, [role=option]");
    if (control && [" ", "Enter"].includes(event.key)) return;
    if (control?.matches("input, [role=radio], [role=option]") && event.key in ARROWS) return;
    if (event.key === " ") {
      actions.panKey(true);
      event.preventDefault();
      return;
    }
    if (event.key in ARROWS) {
      const size = event.altKey || event.ctrlKey || event.metaKey ? "big" : event.shiftKey ? "pixel" : "quarter";
      actions.nudge(ARROWS[event.key], size);
      event.preventDefault();
      return;
    }
    const key = pressed(event);
    if (/^[1-9]$/.test(key)) actions.number(Number(key));
    else if (bindings.has(key)) {
      const [name, argument] = bindings.get(key);
      actions[name](argument);
    } else return;
    event.preventDefault();
  });
  addEventListener("keyup", (event) => {
    if (event.key === " ") actions.panKey(false);
    if (event.key in ARROWS) actions.released();
  });
  addEventListener("blur", () => {
    actions.panKey(false);
    actions.released();
  });
}

/** "shift+g", "mod+z", "?": letters by what they type, or by their place where the layout is not Latin. */
function pressed(event) {
  let key = event.key.toLowerCase();
  if (key.length === 1 && key > "\u007f" && event.code.startsWith("Key")) key = event.code.slice(3).toLowerCase();
  const named = key.length > 1 || /[a-z]/.test(key);
  const parts = [];
  if (event.ctrlKey || event.metaKey) parts.push("mod");
  if (event.altKey) parts.push("alt");
  if (event.shiftKey && named) parts.push("shift");
  return [...parts, key].join("+");
}

export function showHelp() {
  const dialog = byId("help");
  dialog.replaceChildren(
    element(
      "div",
      { class: "dialog-head" },
      element("h2", { id: "help-title" }, "Keys"),
      element("button", { type: "button", class: "text-button", onclick: () => dialog.close() }, "Close"),
    ),
    element("div", { class: "key-columns" }, ...TABLE.map(([name, lines]) => keyGroup(name, lines))),
    element("p", { class: "fine" }, "Tab goes through all controls; in the list of frames the arrow keys go from frame to frame."),
  );
  dialog.showModal();
}

function keyGroup(name, lines) {
  return element(
    "section",
    {},
    element("h3", {}, name),
    element(
      "dl",
      {},
      ...lines.flatMap(([keys, text]) => [
        element("dt", {}, ...keys.flatMap((key, i) => [i ? " " : "", ...combination(key)])),
        element("dd", {}, text),
      ]),
    ),
  );
}

const SHOWN = {
  shift: "Shift", alt: "Alt", arrows: "←↑↓→", enter: "⏎", backspace: "⌫", delete: "Del", esc: "Esc",
  pagedown: "PgDn", pageup: "PgUp", space: "Space", click: "click", drag: "drag", wheel: "wheel",
};

function combination(key) {
  const parts = key === "+" ? ["+"] : key.split("+");
  return parts.map((part) => element("kbd", {}, SHOWN[part] ?? part.toUpperCase()));
}
