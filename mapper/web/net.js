// Requests to the service that sent this page, and to nothing else.

/** Add who asks: the token that this tab was given. */
export function authorized(headers = {}) {
  const token = sessionStorage.getItem("biobot.token");
  return token ? { ...headers, Authorization: `Bearer ${token}` } : headers;
}

/** Return the JSON behind a path, or null if the copy that we have (by its ETag) is still right. */
export function makeFetcher(path) {
  let etag = null;
  return async () => {
    const response = await fetch(path, { headers: authorized(etag ? { "If-None-Match": etag } : {}), cache: "no-store" });
    if (response.status === 304) return null;
    if (!response.ok) throw new Error(`${path}: ${response.status}`);
    etag = response.headers.get("ETag");
    return response.json();
  };
}

const UNREACHED = "no answer from the mapper: nobody can tell whether it was carried out";
const STAGES = { accepted: "accepted by the gateway", radio_confirmed: "sent by the radio" };
const OUTCOMES = {
  biobot_confirmed: "confirmed by the biobot",
  refused: "refused",
  failed: "failed",
  unknown: "sent, but nobody can tell whether it was carried out",
  undelivered: "not delivered",
};

/** What to tell of an answer to a command, as it stands: {isFine, text}; isFine is null while it is under way. */
export function describe({ outcome, stage, reason }) {
  const words = outcome ? OUTCOMES[outcome] ?? outcome : STAGES[stage] ?? "no answer yet";
  return { isFine: outcome ? outcome === "biobot_confirmed" : null, text: reason ? `${words}: ${reason}` : words };
}

/** Send JSON; what comes back, and whether it is no error. An error's `detail` says what is wrong. */
export async function post(path, body) {
  const response = await fetch(path, { method: "POST", headers: authorized({ "Content-Type": "application/json" }), body: JSON.stringify(body) });
  return { isFine: response.ok, answer: await response.json().catch(() => ({ detail: `the mapper answered ${response.status}` })) };
}

/** Give a command and follow it to its end, telling each stage: {isFine, text}. */
export async function sendCommand({ key, action, onStage }) {
  try {
    const given = await post("/api/v1/commands", { biobot: key, action, id: crypto.randomUUID(), wait_s: 0 });
    if (!given.isFine) return { isFine: false, text: given.answer.detail };
    let command = given.answer;
    while (command.outcome === null) {
      onStage(describe({ stage: command.stages.at(-1)?.stage }).text);
      const response = await fetch(`/api/v1/commands/${command.id}?wait_s=20&seen=${command.stages.length}`, { headers: authorized(), cache: "no-store" });
      if (!response.ok) return { isFine: false, text: UNREACHED };
      command = await response.json();
    }
    return describe(command);
  } catch {
    return { isFine: false, text: UNREACHED };
  }
}

/** Call `onVersions` with the newest version numbers whenever one has changed, and `onState` with whether the line is up. */
export function watch({ onVersions, onState }) {
  const source = new EventSource("/api/v1/events");
  source.addEventListener("open", () => onState(true));
  source.addEventListener("error", () => onState(false));
  source.addEventListener("change", (event) => onVersions(JSON.parse(event.data)));
}
