// Who this tab is: the name of its undo history, shared by the tabs of this browser, and a place of its own in
// localStorage for unsent edits. A tab holds a lock on its place while it lives; when the lock comes free, whatever
// lies there was left behind, and another tab sends it.

import { stored } from "./save_queue.js";

/** {clientId, queueKey, home} of this tab in a project. */
export function tabIdentity(project) {
  const home = `bendtrack/${project.name}/${project.scorer}`;
  const queueKey = `${home}/queue/${crypto.randomUUID()}`;
  withLock(queueKey, () => new Promise(() => {}));
  return { clientId: keptName(`${home}/client`), queueKey, home };
}

/** Calls `adopt(edits)` for every other tab's place, at once or when that tab is gone. */
export function inherit({ home, queueKey }, adopt) {
  const places = Object.keys(localStorage).filter((key) => key.startsWith(`${home}/queue/`) && key !== queueKey);
  for (const place of places) {
    withLock(place, () => {
      const edits = stored(place);
      if (edits.length) adopt(edits); // it stores them under the own key before this one is removed
      localStorage.removeItem(place);
    });
  }
}

function withLock(name, action) {
  if (navigator.locks) navigator.locks.request(name, action);
  else action();
}

function keptName(key) {
  const name = localStorage.getItem(key) ?? crypto.randomUUID();
  localStorage.setItem(key, name);
  return name;
}
