// The session's key, with which page and server prove themselves to each other (see API.md, "Authentication").
// No request carries the key: requests are signed with it, and so are the server's answers.

const STORED = "bendtrack/key";
const encoder = new TextEncoder();
let known = { text: null, key: null };

/** Exchange the fragment of a new address for the session's key, if this page was opened by one. */
export async function claimKey(ask) {
  const claim = location.hash.match(/^#claim=([\w-]+)$/)?.[1];
  if (!claim) return;
  history.replaceState(null, "", location.pathname);
  const { key } = await ask(claim);
  localStorage.setItem(STORED, key); // for this page after a reload, and for the other tabs of this address
}

/** Calls back when another tab was let in by a server that was started anew. */
export function onNewKey(action) {
  addEventListener("storage", (event) => event.key === STORED && action());
}

/** {nonce, value} of the header that a request needs. */
export async function credential(method, address, key = storedKey()) {
  const nonce = base64url(crypto.getRandomValues(new Uint8Array(16)));
  return { nonce, value: `${nonce}.${await signature(key, "page", nonce, method, address)}` };
}

/** Whether an answer comes from the server that has the key. */
export async function isProof(proof, nonce, status, key = storedKey()) {
  return proof === (await signature(key, "server", nonce, String(status)));
}

/** An address for what cannot send a header. */
export async function signedAddress(address) {
  return `${address}?sig=${await signature(storedKey(), "address", address)}`;
}

function storedKey() {
  return localStorage.getItem(STORED) ?? "none";
}

async function signature(text, ...parts) {
  if (known.text !== text) {
    const hmac = { name: "HMAC", hash: "SHA-256" };
    known = { text, key: await crypto.subtle.importKey("raw", encoder.encode(text), hmac, false, ["sign"]) };
  }
  return base64url(new Uint8Array(await crypto.subtle.sign("HMAC", known.key, encoder.encode(parts.join("\n")))));
}

function base64url(bytes) {
  return btoa(String.fromCharCode(...bytes)).replaceAll("+", "-").replaceAll("/", "_").replaceAll("=", "");
}
