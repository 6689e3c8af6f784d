// Requests to the service that sent this page, and to nothing else.

/** Return the JSON behind a path, or null if the copy that we have (by its ETag) is still right. */
export function makeFetcher(path) {
  let etag = null;
  return async () => {
    const response = await fetch(path, { headers: etag ? { "If-None-Match": etag } : {}, cache: "no-store" });
    if (response.status === 304) return null;
    if (!response.ok) throw new Error(`${path}: ${response.status}`);
    etag = response.headers.get("ETag");
    return response.json();
  };
}

/** Give a command and wait for its end: {isFine, text}. */
export async function sendCommand({ key, action, operator }) {
  const id = crypto.randomUUID();
  let response;
  try {
    response = await fetch("/api/v1/commands", {
      method: "POST",
      headers: { "Content-Type": "application/json" },
      body: JSON.stringify({ biobot: key, action, operator, id }),
    });
  } catch {
    return { isFine: false, text: "no answer from the mapper: nobody can tell whether it was carried out" };
  }
  const answer = await response.json().catch(() => ({}));
  if (!response.ok) return { isFine: false, text: answer.detail ?? `the mapper answered ${response.status}` };
  const words = {
    biobot_confirmed: "confirmed by the biobot",
    failed: "failed",
    unknown: "sent, but nobody can tell whether it was carried out",
  };
  const reason = answer.reason ? `: ${answer.reason}` : "";
  return { isFine: answer.outcome === "biobot_confirmed", text: `${words[answer.outcome] ?? answer.outcome}${reason}` };
}

/** Call `onVersions` with the newest version numbers whenever one has changed, and `onState` with whether the line is up. */
export function watch({ onVersions, onState }) {
  const source = new EventSource("/api/v1/events");
  source.addEventListener("open", () => onState(true));
  source.addEventListener("error", () => onState(false));
  source.addEventListener("change", (event) => onVersions(JSON.parse(event.data)));
}
