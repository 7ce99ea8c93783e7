// Server-sent events, and whether the connection to the server is up.

const AGAIN_MS = 700;

/** listener: {connected(serverId), lost(), changed(event), frames(), predicted(event), model(event)}. */
export function listen(listener) {
  let source = null;
  const open = () => {
    source = new EventSource("/api/events");
    source.onmessage = (message) => {
      const event = JSON.parse(message.data);
      if (event.type === "hello") listener.connected(event.server_id);
      else listener[event.type]?.(event);
    };
    source.onerror = () => {
      listener.lost();
      // A refused connection is retried by the browser, but not after an answer that it takes for final.
      source.close();
      setTimeout(() => document.hidden || open(), AGAIN_MS);
    };
  };
  open();
  // A browser opens few connections to one server: hidden tabs release theirs for the others.
  document.addEventListener("visibilitychange", () => {
    source.close();
    if (!document.hidden) open();
  });
  addEventListener("pagehide", () => source.close());
}
