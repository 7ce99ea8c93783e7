// Entry point of the page: fetches the project, creates the parts and connects them.

import { makeActions } from "./actions.js";
import { Refused, Unproven, Unreachable, askForKey, get, send } from "./api.js";
import { chooseVersion } from "./conflict_dialog.js";
import { connectControls } from "./controls.js";
import { FrameNavigator } from "./frame_navigator.js";
import { byId } from "./elements.js";
import { offerFinish } from "./finish.js";
import { hideEmpty, showEmpty } from "./empty_page.js";
import { Filmstrip } from "./filmstrip.js";
import { FrameList } from "./frame_list.js";
import { History } from "./history.js";
import { ImageCache } from "./image_cache.js";
import { listenToKeys } from "./keys.js";
import { showMessage, setBanner } from "./message.js";
import { OpenFrame } from "./open_frame.js";
import { Options } from "./options.js";
import { Pointer } from "./pointer.js";
import { PointsPanel } from "./points_panel.js";
import { showAngle, showFrameState, showHint, showPosition } from "./readout.js";
import { RepeatRound } from "./repeat_round.js";
import { showSaving } from "./save_indicator.js";
import { SaveQueue } from "./save_queue.js";
import { disagreements, makeScene } from "./scene.js";
import { listen } from "./server_events.js";
import { claimKey, onNewKey } from "./session.js";
import { Stage } from "./stage.js";
import { adoptOrphanedEdits, tabIdentity } from "./tab_identity.js";
import { startTheme } from "./theme.js";
import { Tone } from "./tone.js";
import { View } from "./view.js";

const LIST_AGAIN_MS = 1500;

startTheme(byId("theme"));
start().catch(async (error) => {
  if (error instanceof Unproven) {
    onNewKey(() => location.reload());
    showEmpty("This page has no session", "Open the address that this command prints:", "bendtrack label PROJECT");
    return;
  }
  if (!(error instanceof Refused || error instanceof Unreachable)) throw error;
  const heading = error instanceof Refused ? "The project cannot be read" : "The server does not answer";
  showEmpty(heading, `${error.message}. The page goes on when this command runs:`, "bendtrack label PROJECT");
  let answer = null;
  while (!answer) {
    await new Promise((resolve) => setTimeout(resolve, LIST_AGAIN_MS));
    answer = await get("/api/frames").catch(() => null);
  }
  location.reload();
});

async function start() {
  await claimKey(askForKey).catch(() => {}); // used already: then there is a key, or the next request says so
  const project = await get("/api/project");
  byId("project-name").textContent = project.name;
  document.title = `${project.name} · bendtrack`;

  const identity = tabIdentity(project);
  const queue = new SaveQueue(identity.queueKey, (edit) => send("PUT", edit.url, sentBody(edit, identity.clientId)));
  const open = new OpenFrame((frame, body, merge) => {
    if (frame.repeat) return; // saved when all of it is placed
    queue.add({ kind: "frame", id: frame.id, url: frame.url, body, base_revision: frame.revision }, merge);
  });
  const list = new FrameList();
  const view = new View();
  const options = new Options();
  const cache = new ImageCache();
  const pointer = new Pointer(byId("stage"), open, view, options);
  const stage = new Stage(byId("stage"), view, () => makeScene(project, { open, view, pointer, options }));
  const history = new History(queue, identity.clientId);
  const filmstrip = new Filmstrip(list, project.keypoints.length, (id, { keepFocus }) => {
    frameNavigator.go(id);
    if (!keepFocus) byId("stage").focus({ preventScroll: true });
  });
  const frameNavigator = new FrameNavigator({ project, list, open, queue, cache, stage, filmstrip });
  const repeats = new RepeatRound({ open, queue, cache, stage, frameNavigator, finished: afterRepeats });
  const tone = new Tone();
  const pointsPanel = new PointsPanel(project.keypoints, open);
  const actions = makeActions({ project, list, open, queue, frameNavigator, view, stage, pointer, options, history, repeats, reload });
  connectControls({ actions, open, queue, tone, options });
  listenToKeys(actions);

  async function reload() {
    const frames = await queue.undisturbed(() => get("/api/frames"));
    list.load(frames);
    const { due } = frames.repeats;
    byId("repeats-due").hidden = !(due > 0);
    byId("repeats-due").textContent = due > 0 ? `${due} ${due === 1 ? "frame" : "frames"} to label again, blind` : "";
    return frames;
  }

  function afterRepeats(spread) {
    troubleShown = null; // the round had the banner
    showTrouble();
    if (spread) showMessage(`Your own spread: ${spread.px.toFixed(2)} px${spread.deg === null ? "" : `, ${spread.deg.toFixed(2)}°`} (I shows more).`, 8000);
    frameNavigator.go(frameNavigator.current);
    reload().catch(() => {});
  }

  const followPointer = () => {
    stage.redraw("marks");
    showPosition(view, options.keyboardCursor ?? pointer.over);
  };
  const refreshMarks = () => {
    followPointer();
    showAngle(project, open);
    showHint(project, open, Boolean(options.keyboardCursor));
    showFrameState(open);
    pointsPanel.update(disagreements(open, view.image));
  };
  for (const name of ["open", "points", "selection"]) open.addEventListener(name, refreshMarks);
  open.addEventListener("open", () => (options.keyboardCursor = null));
  options.addEventListener("change", () => stage.redraw("marks"));
  view.addEventListener("change", followPointer);
  pointer.addEventListener("change", () => {
    followPointer();
    showHint(project, open, Boolean(options.keyboardCursor));
  });
  pointer.addEventListener("missed", ({ detail }) => {
    showMessage(detail.complete ? "All points are set. Drag one to move it." : "That is outside of the image.");
  });
  pointer.addEventListener("cancelled", () => {
    open.endDrag();
    open.adopt(open.frame, queue.latest(open.frame?.id)?.body);
  });

  queue.addEventListener("status", () => {
    showSaving(queue.status);
    showTrouble();
  });
  onNewKey(() => queue.retry());
  queue.addEventListener("saved", ({ detail: { edit, answer } }) => {
    if (edit.kind !== "frame") return;
    list.update(answer);
    open.adopt(answer, queue.latest(answer.id)?.body);
    settleSign();
  });
  queue.addEventListener("conflict", settleConflicts);
  addEventListener("beforeunload", (event) => {
    queue.release();
    if (queue.status.waiting && queue.status.state !== "saving") event.preventDefault();
  });

  let finished = false; // the server has ended because this page said so
  let signedOut = false;
  let troubleShown = null;
  let choosing = false;
  async function settleConflicts() {
    if (choosing) return;
    choosing = true;
    for (let [id] = queue.conflicts; id; [id] = queue.conflicts) {
      if (repeats.active) repeats.leave();
      if (frameNavigator.current !== id) await frameNavigator.go(id);
      const theirs = queue.conflict(id);
      const choice = await chooseVersion({
        row: list.get(id),
        mine: queue.latest(id).body,
        theirs,
        keypoints: project.keypoints,
        bitmap: stage.bitmap,
      });
      list.update(theirs);
      if (choice === "mine") queue.keepMine(id);
      else queue.takeTheirs(id);
      open.adopt(theirs, queue.latest(id)?.body);
    }
    choosing = false;
  }

  /** With sign "auto" the labels decide which way is positive. */
  let signAsked = false;
  async function settleSign() {
    if (signAsked) return;
    signAsked = true;
    await new Promise((resolve) => setTimeout(resolve, LIST_AGAIN_MS));
    signAsked = false;
    const fresh = await get("/api/project").catch(() => null);
    const settled = ({ definition, signs }) => JSON.stringify([definition.sign, signs]);
    if (!fresh || settled(fresh) === settled(project)) return;
    Object.assign(project, { definition: fresh.definition, signs: fresh.signs });
    refreshMarks();
  }

  let listAgain = null;
  const reloadSoon = () => {
    listAgain ??= setTimeout(() => {
      listAgain = null;
      reload().catch(() => {});
    }, LIST_AGAIN_MS);
  };

  if (project.can_finish) offerFinish({ list, queue, clientId: identity.clientId, ended: () => (finished = true) });
  adoptOrphanedEdits(identity, (edits) => queue.adopt(edits));
  await openFirst();

  /** The frame of the address, or the next to do; nothing where that one is open already. */
  async function openFirst() {
    const frames = await reload();
    if (!list.rows.length) {
      open.close();
      showEmpty("No frames to label yet", "Choose some from your videos; they appear here by themselves:", "bendtrack frames PROJECT VIDEO…");
      return;
    }
    hideEmpty();
    // A frame with unsent edits stays open, though its image has gone: the next click is meant for it.
    if (list.get(open.frame?.id) || queue.latest(open.frame?.id)) return;
    const wanted = [frameNavigator.current, decodeURIComponent(location.hash.slice(1))].find((id) => list.get(id));
    await frameNavigator.go(wanted ?? frames.next ?? list.rows[0].id);
    if (document.activeElement === document.body) byId("stage").focus({ preventScroll: true });
  }

  listen({
    async connected() {
      const answer = await get("/api/proof").catch((reason) => reason);
      signedOut = answer instanceof Unproven;
      showTrouble();
      if (answer instanceof Error) return;
      queue.setConnected(true);
      // Changes while no events were received, including those since the list was fetched.
      await openFirst().catch(() => {});
      if (open.frame) frameNavigator.refresh(open.frame.id);
    },
    async lost() {
      if (finished) return;
      queue.setConnected(false);
      const error = await get("/api/project").catch((reason) => reason);
      signedOut = error instanceof Unproven;
      showTrouble();
    },
    changed({ id, edit_id: editId }) {
      if (queue.isOwn(editId) || history.isOwn(editId)) return;
      if (list.get(id)) frameNavigator.refresh(id);
      else reloadSoon();
    },
    frames: () => openFirst().catch(() => {}),
    predicted({ id }) {
      if (id === open.frame?.id) frameNavigator.refreshSuggestions();
      reloadSoon();
    },
    model: reloadSoon,
  });

  /** The banner says why edits wait, and what to do. */
  function showTrouble() {
    if (repeats.active) return;
    const { state, waiting, reason } = queue.status;
    let text = null;
    let buttons = [];
    if (signedOut || state === "session") {
      text = "The server of this page has ended, and something else answers in its place. Do not reload: open the address that bendtrack label prints, in this browser.";
      if (waiting) text += " Unsent edits are kept and go with it.";
    } else if (state === "disk") text = `Not on disk, edits are kept here and sent again: ${reason}`;
    else if (state === "refused") {
      const refused = queue.refused.map((id) => id.replace(/^repeat /, ""));
      const frames = refused.slice(0, 3).join(", ") + (refused.length > 3 ? ` and ${refused.length - 3} more` : "");
      text = `Not saved: ${frames} (${reason}). Kept here and sent again.`;
      buttons = [
        { text: "Send again", run: () => queue.retry(), main: true },
        { text: "Drop these edits", run: dropRefused },
      ];
    }
    if (text === troubleShown) return;
    troubleShown = text;
    setBanner(text, buttons, "trouble");
  }

  function dropRefused() {
    const ids = queue.refused;
    queue.dropRefused();
    for (const id of ids) if (id === open.frame?.id) frameNavigator.refresh(id);
  }
}

function sentBody(edit, clientId) {
  const body = { ...edit.body, edit_id: edit.edit_id, client_id: clientId };
  return edit.kind === "frame" ? { ...body, base_revision: edit.base_revision } : body;
}
