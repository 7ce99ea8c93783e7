// Requests to the server (see API.md). The caller decides what to do about an answer.

const TIMEOUT_MS = 15000;

/** No answer: the server is down, or busy beyond patience. */
export class Unreachable extends Error {}

/** A refusal; `status` and, where there is one, `body`. */
export class Refused extends Error {
  constructor(status, body) {
    super(body?.reason ?? `the server answered ${status}`);
    this.status = status;
    this.body = body;
  }
}

export function get(address) {
  return request(address, { method: "GET" });
}

/** PUT or POST; null for an answer without content. */
export function send(method, address, body) {
  return request(address, {
    method,
    headers: { "Content-Type": "application/json", "X-Bendtrack": "1" },
    body: JSON.stringify(body),
  });
}

async function request(address, options) {
  let response;
  let body = null;
  try {
    response = await fetch(address, {
      ...options,
      credentials: "same-origin",
      cache: "no-store",
      signal: AbortSignal.timeout(TIMEOUT_MS),
    });
    const text = await response.text();
    if (text) body = JSON.parse(text);
  } catch (error) {
    throw new Unreachable(error.name === "TimeoutError" ? "no answer in time" : "no connection");
  }
  if (!response.ok) throw new Refused(response.status, body);
  return body;
}
