// Server-sent events, and whether the connection to the server is up.

import { signedAddress } from "./session.js";

const AGAIN_MS = 700;

/** listener: {connected(serverId), lost(), changed(event), frames(), predicted(event), model(event)}. */
export function listen(listener) {
  let source = null;
  const open = async () => {
    const address = await signedAddress("/api/events"); // by the key of now: another tab may have a new one
    source?.close();
    if (document.hidden) return;
    const own = (source = new EventSource(address));
    own.onmessage = (message) => {
      const event = JSON.parse(message.data);
      if (event.type === "hello") listener.connected(event.server_id);
      else listener[event.type]?.(event);
    };
    own.onerror = () => {
      if (own !== source) return;
      listener.lost();
      // A refused connection is retried by the browser, but not after an answer that it takes for final.
      own.close();
      setTimeout(() => document.hidden || own !== source || open(), AGAIN_MS);
    };
  };
  open();
  // A browser opens few connections to one server: hidden tabs release theirs for the others.
  document.addEventListener("visibilitychange", () => {
    source?.close();
    if (!document.hidden) open();
  });
  addEventListener("pagehide", () => source?.close());
}
