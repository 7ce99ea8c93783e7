// Requests to the server (see API.md), each answer checked to be the server's. The caller decides what to do about it.

import { credential, isProof } from "./session.js";

const TIMEOUT_MS = 15000;

/** No answer: the server is down, or busy beyond patience. */
export class Unreachable extends Error {}

/** An answer that does not prove the server: another program has the port, or a server that was started anew. */
export class Unproven extends Error {}

/** A refusal of the server; `status` and, where there is one, `body`. */
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
export async function send(method, address, body) {
  // The server may have died since the last answer: nothing is sent to a program that has taken its port.
  await get("/api/proof");
  return request(address, {
    method,
    headers: { "Content-Type": "application/json", "X-Bendtrack": "1" },
    body: JSON.stringify(body),
  });
}

/** The session's key, for the fragment of a new address. */
export function askForKey(claim) {
  return request("/api/key", { method: "GET" }, claim);
}

async function request(address, options, key = undefined) {
  const { nonce, value } = await credential(options.method, address, key);
  let response;
  let text;
  try {
    response = await fetch(address, {
      ...options,
      headers: { ...options.headers, "X-Bendtrack-Auth": value },
      credentials: "same-origin",
      cache: "no-store",
      redirect: "error",
      signal: AbortSignal.timeout(TIMEOUT_MS),
    });
    text = await response.text();
  } catch (error) {
    throw new Unreachable(error.name === "TimeoutError" ? "no answer in time" : "no connection");
  }
  if (!(await isProof(response.headers.get("X-Bendtrack-Proof"), nonce, response.status, key))) {
    throw new Unproven("the answer is not of the server that this page belongs to");
  }
  const body = parsed(text);
  if (!response.ok) throw new Refused(response.status, body);
  return body;
}

function parsed(text) {
  try {
    return text ? JSON.parse(text) : null;
  } catch {
    return null; // of an error that nobody expected: its status says enough
  }
}
