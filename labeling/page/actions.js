// The actions of the keys and the buttons.

import { get } from "./api.js";
import { byId } from "./elements.js";
import { FILTERS } from "./frame_list.js";
import { showHelp } from "./keys.js";
import { showMessage } from "./message.js";
import { showSummary } from "./summary_dialog.js";

const STEP_PX = { quarter: 0.25, pixel: 1 };
const BIG_STEPS = 40; // across what is visible

/** The actions that `keys.js` names, on the parts of the page. */
export function makeActions({ project, list, open, queue, frameNavigator, view, stage, pointer, options, history, repeats, reload }) {
  /** Position at which the keyboard places a point: its crosshair, or a start for it. */
  const crosshair = () =>
    options.keyboardCursor ??
    (open.isRepeat ? null : open.frame?.suggestions?.[open.target]?.xy) ??
    pointer.over ??
    view.clamped(view.toImage([view.screen.width / 2, view.screen.height / 2]));

  const setCursor = (xy) => {
    options.keyboardCursor = xy;
    if (xy) view.reveal(xy);
    stage.redraw("marks");
    open.dispatchEvent(new Event("selection"));
  };

  const editable = () => open.frame && !open.locked;

  /** Points of another source for the missing keypoints, or for all of them. */
  const fill = (source, all, text) => {
    if (!editable() || open.isRepeat) return;
    const names = open.keypoints.filter((name) => source[name] && (all || open.isMissing(name)));
    if (names.length) open.set(Object.fromEntries(names.map((name) => [name, view.clamped(source[name])])));
    else showMessage(text);
  };

  const step = async (way) => {
    if (open.isRepeat) return;
    const { frame, text } = await history.step(way);
    if (text) showMessage(text);
    if (frame) await frameNavigator.show(frame);
  };

  return {
    nudge([dx, dy], size) {
      if (!editable()) return;
      const px = STEP_PX[size] ?? Math.max(1, Math.round(view.screen.width / view.scale / BIG_STEPS));
      const name = open.selected;
      if (open.isPlaced(name)) {
        options.keyboardCursor = null;
        const [x, y] = open.points[name];
        const xy = view.clamped([x + dx * px, y + dy * px]);
        open.set({ [name]: xy }, `nudge ${name}`);
        view.reveal(xy);
        const moved = Math.hypot(xy[0] - x, xy[1] - y);
        showMessage(moved ? `${name} moved by ${Number(moved.toFixed(2))} px. Z undoes it.` : `${name} is at the edge of the image.`);
      } else {
        const [x, y] = crosshair();
        setCursor(view.clamped([x + dx * px, y + dy * px]));
      }
    },

    released() {
      queue.release();
    },

    enter() {
      if (!editable()) return;
      const name = open.selected;
      const target = open.target;
      if (name && open.isMissing(name)) {
        if (!options.keyboardCursor) return setCursor(crosshair());
        const xy = options.keyboardCursor;
        options.keyboardCursor = null;
        open.set({ [name]: xy });
      } else if (target) {
        open.select(target);
        options.keyboardCursor = null;
        setCursor(crosshair());
      } else if (open.isRepeat) repeats.submit();
      else this.nextToDo();
    },

    select(steps) {
      options.keyboardCursor = null;
      open.selectStep(steps);
    },

    number(n) {
      options.keyboardCursor = null;
      if (project.keypoints[n - 1]) open.select(project.keypoints[n - 1]);
    },

    notVisible: () => open.toggleNotVisible(open.selected),
    remove: () => open.isPlaced(open.selected) && open.set({ [open.selected]: null }),
    flag: () => editable() && open.toggleFlagged(),
    skip: () => editable() && open.toggleSkipped(),
    note: () => byId("note").focus(),
    copyPrevious(all) {
      if (!open.frame?.previous) return showMessage("No frame before this one has points.");
      fill(open.frame.previous.points, all, "All points are set already. Shift+C replaces them.");
    },
    acceptSuggestions(all) {
      const suggestions = Object.entries(open.frame?.suggestions ?? {}).map(([name, { xy }]) => [name, xy]);
      if (!suggestions.length) return showMessage("There are no suggestions here yet: they come from labelled frames nearby, or from a network.");
      fill(Object.fromEntries(suggestions), all, "All points are set already. Shift+G replaces them.");
    },
    undo: () => step("undo"),
    redo: () => step("redo"),

    step: (steps) => !repeats.active && frameNavigator.step(steps),
    nextToDo() {
      if (repeats.active) return;
      const id = list.nextToDo(frameNavigator.current);
      if (id) frameNavigator.go(id);
      else showMessage(open.missing().length ? "Only this frame is left." : "Every frame is labelled.");
    },
    filter() {
      const names = Object.keys(FILTERS);
      list.setFilter(names[(names.indexOf(list.filter) + 1) % names.length]);
    },
    async summary() {
      await queue.drained();
      try {
        const [summary] = await Promise.all([get("/api/summary"), reload()]);
        showSummary(summary, list.repeats, () => repeats.next());
      } catch (error) {
        showMessage(error.message);
      }
    },
    async repeats() {
      if (!repeats.active && (await queue.drained())) repeats.next();
    },

    zoom(factor) {
      const about = options.keyboardCursor ?? open.points[open.selected] ?? pointer.over;
      const { width, height } = view.screen;
      view.zoomAt(about ? view.toScreen(about) : [width / 2, height / 2], factor);
    },
    fit: () => view.fit(),
    loupe: () => options.toggle("loupe"),
    suggestions: () => options.toggle("suggestions"),
    panKey: (held) => pointer.setPanKey(held),
    escape() {
      if (pointer.cancel()) return;
      if (options.keyboardCursor) setCursor(null);
      else if (repeats.active) repeats.leave();
      else byId("stage").focus({ preventScroll: true });
    },
    help: showHelp,
  };
}
