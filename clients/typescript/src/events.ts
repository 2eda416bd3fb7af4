import { type Server, ask, askJson, at } from "./http.js";
import { Problem } from "./problem.js";
import { pause, pauseAfter } from "./retry.js";
import type { Job, ProgressEvent } from "./shapes.js";

/** Longest silence of a stream in milliseconds. The service sends at least one line every 15 seconds. */
const MAX_SILENCE = 45_000;
const ENDED = new Set(["succeeded", "failed", "canceled", "expired"]);

export function hasEnded(job: Pick<Job, "status">): boolean {
  return ENDED.has(job.status);
}

/** The progress of a job in the shape of an event; null once the job has ended. */
export function standing(job: Job): ProgressEvent | null {
  return job.progress && { ...job.progress, status: job.status };
}

/** Either the progress of a job, or the ended job. */
export type JobEvent = { name: "progress"; progress: ProgressEvent } | { name: "done"; job: Job };

/**
 * Yields the events of a job until it ends, from the event stream, or by long polling if a proxy buffers the stream. Reconnects after a
 * lost connection. The first event after that is the current state.
 */
export async function* events(server: Server, id: string, signal?: AbortSignal): AsyncGenerator<JobEvent, void, undefined> {
  let [streaming, hasStreamed] = [true, false];
  for (let failures = 0; ; ) {
    let heard = false;
    try {
      for await (const event of streaming ? stream(server, id, signal) : poll(server, id, signal)) {
        heard = true;
        hasStreamed ||= streaming;
        yield event;
        if (event.name === "done") return;
      }
      failures = 0;
      streaming = hasStreamed;
    } catch (error) {
      if (signal?.aborted || !(error instanceof Problem) || !error.isTransient) throw error;
      failures = heard ? 1 : failures + 1;
      // Without any event a proxy may buffer the stream, so the next attempt uses the other method.
      if (!heard) streaming = !streaming;
      await pause(pauseAfter(failures, error), signal);
    }
  }
}

/** Waits until a job ends, and returns it. `onProgress` receives the progress. */
export async function follow(server: Server, id: string, onProgress: (event: ProgressEvent) => void, signal?: AbortSignal): Promise<Job> {
  for await (const event of events(server, id, signal)) {
    if (event.name === "done") return event.job;
    onProgress(event.progress);
  }
  throw Problem.unreachable();
}

/** Requests the job once. The response arrives when the job's status changes, or after 20 seconds. */
async function* poll(server: Server, id: string, signal?: AbortSignal): AsyncGenerator<JobEvent, void, undefined> {
  const job = await askJson<Job>(server, `${at("/v1/jobs/{id}", { id })}?include=report&wait=20`, { signal });
  const progress = standing(job);
  if (hasEnded(job)) yield { name: "done", job };
  else if (progress) yield { name: "progress", progress };
}

/** Reads the event stream of a job until it ends. Throws a `Problem` if the stream breaks before. */
async function* stream(server: Server, id: string, signal?: AbortSignal): AsyncGenerator<JobEvent, void, undefined> {
  // EventSource cannot send a key.
  const answer = await ask(server, `${at("/v1/jobs/{id}/events", { id })}?include=report`, { headers: { accept: "text/event-stream" }, signal });
  const reader = answer.body?.pipeThrough(new TextDecoderStream()).getReader();
  if (!reader) throw Problem.unreachable();
  const parser = new EventParser();
  try {
    for (;;) {
      const timer = setTimeout(() => void reader.cancel().catch(() => undefined), MAX_SILENCE);
      const { done, value } = await reader.read().catch(() => ({ done: true, value: undefined }));
      clearTimeout(timer);
      if (signal?.aborted) throw signal.reason;
      for (const event of parser.push(value ?? "")) {
        if (event.name === "done") return yield { name: "done", job: JSON.parse(event.data) as Job };
        if (event.name === "progress") yield { name: "progress", progress: JSON.parse(event.data) as ProgressEvent };
      }
      if (done) throw Problem.unreachable();
    }
  } finally {
    void reader.cancel().catch(() => undefined);
  }
}

/** Parses server-sent events (HTML standard, section 9.2.6) from pieces of text. */
export class EventParser {
  #rest = "";
  #name = "";
  #data: string[] = [];

  push(piece: string): { name: string; data: string }[] {
    const lines = (this.#rest + piece).split(/\r\n|\n|\r(?!$)/);
    this.#rest = lines.pop() ?? "";
    const events: { name: string; data: string }[] = [];
    for (const line of lines) {
      if (line === "") {
        if (this.#data.length > 0) events.push({ name: this.#name || "message", data: this.#data.join("\n") });
        this.#name = "";
        this.#data = [];
        continue;
      }
      const colon = line.indexOf(":");
      if (colon === 0) continue;
      const field = colon < 0 ? line : line.slice(0, colon);
      const value = colon < 0 ? "" : line.slice(colon + 1).replace(/^ /, "");
      if (field === "event") this.#name = value;
      if (field === "data") this.#data.push(value);
    }
    return events;
  }
}
