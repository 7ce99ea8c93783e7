// Identity of this tab: the id of its undo history, shared by the tabs of this browser, and its own key in localStorage
// for unsent edits. A tab holds a lock on its key while it is open. When the lock is released, edits under the key are
// orphaned, and another tab sends them.

import { stored } from "./save_queue.js";

/** {clientId, queueKey, home} of this tab in a project. */
export function tabIdentity(project) {
  const home = `bendtrack/${project.name}/${project.scorer}`;
  const queueKey = `${home}/queue/${crypto.randomUUID()}`;
  withLock(queueKey, () => new Promise(() => {}));
  return { clientId: storedId(`${home}/client`), queueKey, home };
}

/** Calls `adopt(edits)` with the edits of every other tab, once that tab is closed. */
export function adoptOrphanedEdits({ home, queueKey }, adopt) {
  const keys = Object.keys(localStorage).filter((key) => key.startsWith(`${home}/queue/`) && key !== queueKey);
  for (const other of keys) {
    withLock(other, () => {
      const edits = stored(other);
      if (edits.length) adopt(edits); // which stores them under the own key before the other one is removed
      localStorage.removeItem(other);
    });
  }
}

function withLock(name, action) {
  if (navigator.locks) navigator.locks.request(name, action);
  else action();
}

function storedId(key) {
  const name = localStorage.getItem(key) ?? crypto.randomUUID();
  localStorage.setItem(key, name);
  return name;
}
