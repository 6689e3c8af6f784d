// Every request to the service that sent this page, and to nothing else: the token goes along, and errors become sentences.

const TOKEN_KEY = "biobot.token";
const PATIENCE_MS = 30_000;
const RETRY_MS = 400;

let token = recallToken();

/** What the mapper answered in place of what was asked for, or that it did not answer (status 0). `text` says what to do. */
export class Problem extends Error {
  constructor({ status, detail, facts = {} }) {
    super(detail);
    Object.assign(this, { status, detail, facts });
  }

  get text() {
    // What is said to programs of a missing token is about headers.
    if (this.status === 401) return "This needs a token that is valid here: sign in.";
    const steps = { 0: "Look whether it runs and whether this machine reaches it; the page tries again by itself.", 500: "The mapper's log says more." };
    const step = steps[this.status];
    return step ? `${sentence(this.detail)} ${step}` : sentence(this.detail);
  }
}

/** The token goes with every request from now on; null: none does. It is kept as long as this tab is open, and never in a URL. */
export function setToken(value) {
  token = value;
  try {
    if (value === null) sessionStorage.removeItem(TOKEN_KEY);
    else sessionStorage.setItem(TOKEN_KEY, value);
  } catch {
    // then it is forgotten when the page is loaded again
  }
}

export function hasToken() {
  return token !== null;
}

/** A function that returns the JSON behind a path, or null if the copy that it returned before is still right (by its ETag). */
export function makeFetcher(path) {
  let etag = null;
  return async () => {
    const response = await ask("GET", path, { headers: etag ? { "If-None-Match": etag } : {} });
    if (response.status === 304) return null;
    etag = response.headers.get("ETag");
    return response.json();
  };
}

/** The JSON behind a path; `as` is a token that is tried for this request alone. */
export async function getJson(path, { patienceMs = PATIENCE_MS, as } = {}) {
  return (await ask("GET", path, { patienceMs, as })).json();
}

export async function getBlob(path) {
  return (await ask("GET", path, {})).blob();
}

/** Save what is behind a path as a file: fetched with the token, so that the token is in no link. */
export async function save(path, filename) {
  const url = URL.createObjectURL(await getBlob(path));
  const link = document.createElement("a");
  link.href = url;
  link.download = filename;
  link.click();
  setTimeout(() => URL.revokeObjectURL(url), 60_000);
}

/** Send JSON; what comes back, or null where nothing does. Tried again where nobody answered: only for what is the same when it comes twice. */
export async function send(method, path, body, { tries = 1, patienceMs = PATIENCE_MS } = {}) {
  for (let left = tries - 1; ; left--) {
    try {
      const headers = body === undefined ? {} : { "Content-Type": "application/json" };
      const response = await ask(method, path, { headers, body: body === undefined ? undefined : JSON.stringify(body), patienceMs });
      return response.status === 204 ? null : await response.json();
    } catch (problem) {
      if (problem.status !== 0 || left <= 0) throw problem;
      await new Promise((resolve) => setTimeout(resolve, RETRY_MS));
    }
  }
}

/** The body of an endless answer, as text in pieces; ends with the answer, or when `signal` says so. */
export async function* readTexts(path, signal) {
  const response = await ask("GET", path, { signal, patienceMs: null });
  const reader = response.body.pipeThrough(new TextDecoderStream()).getReader();
  for (;;) {
    const { done, value } = await reader.read();
    if (done) return;
    yield value;
  }
}

async function ask(method, path, { headers = {}, body, signal, as, patienceMs = PATIENCE_MS }) {
  const asked = as ?? token;
  const ends = [signal, patienceMs === null ? null : AbortSignal.timeout(patienceMs)].filter(Boolean);
  let response;
  try {
    response = await fetch(path, {
      method,
      body,
      headers: asked === null ? headers : { ...headers, Authorization: `Bearer ${asked}` },
      signal: ends.length ? AbortSignal.any(ends) : undefined,
      cache: "no-store",
      credentials: "omit",
      redirect: "error",
    });
  } catch {
    throw new Problem({ status: 0, detail: "The mapper does not answer." });
  }
  if (response.ok || response.status === 304) return response;
  const facts = await response.json().catch(() => ({}));
  if (response.status === 401 && asked === token) document.dispatchEvent(new Event("signinwanted"));
  throw new Problem({ status: response.status, detail: facts.detail ?? `The mapper answered ${response.status} to ${path}.`, facts });
}

function recallToken() {
  try {
    return sessionStorage.getItem(TOKEN_KEY);
  } catch {
    return null;
  }
}

function sentence(text) {
  const trimmed = text.trim();
  return trimmed.charAt(0).toUpperCase() + trimmed.slice(1) + (/[.!?]$/.test(trimmed) ? "" : ".");
}
