import { type Server, ask, askJson, at } from "./http.js";
import { Problem } from "./problem.js";
import { pause, pauseAfter } from "./retry.js";
import type { Job, ProgressEvent } from "./shapes.js";

/** The service says something every 15 seconds; a stream that is silent for longer than this has broken without a word. */
const SILENCE = 45_000;
const ENDED = new Set(["succeeded", "failed", "canceled", "expired"]);

export function hasEnded(job: Pick<Job, "status">): boolean {
  return ENDED.has(job.status);
}

/** How far a job was when it was last heard of, as its events tell it; null once it has ended. */
export function standing(job: Job): ProgressEvent | null {
  return job.progress && { ...job.progress, status: job.status };
}

/** What is heard of a job: progress, and at last the job as it ended. */
export type JobEvent = { name: "progress"; progress: ProgressEvent } | { name: "done"; job: Job };

/**
 * Listens to a job until its end: by its events, or where a proxy holds those back, by asking. A connection that breaks is made again,
 * and then the present state is told first.
 */
export async function* events(server: Server, id: string, signal?: AbortSignal): AsyncGenerator<JobEvent, void, undefined> {
  let [streaming, hasStreamed] = [true, false];
  for (let failures = 0; ; ) {
    let heard = false;
    try {
      for await (const event of streaming ? listen(server, id, signal) : look(server, id, signal)) {
        heard = true;
        hasStreamed ||= streaming;
        yield event;
        if (event.name === "done") return;
      }
      failures = 0;
      streaming = hasStreamed;
    } catch (error) {
      if (signal?.aborted || !(error instanceof Problem) || !error.isPassing) throw error;
      failures = heard ? 1 : failures + 1;
      // Where nothing was heard something may hold it back, and the other way is tried.
      if (!heard) streaming = !streaming;
      await pause(pauseAfter(failures, error), signal);
    }
  }
}

/** Follows a job to its end, which is what it returns; `heard` is told of progress. */
export async function follow(server: Server, id: string, heard: (event: ProgressEvent) => void, signal?: AbortSignal): Promise<Job> {
  for await (const event of events(server, id, signal)) {
    if (event.name === "done") return event.job;
    heard(event.progress);
  }
  throw Problem.unreachable();
}

/** Asks once, with an answer that is held until the job's status changes or 20 seconds are over. */
async function* look(server: Server, id: string, signal?: AbortSignal): AsyncGenerator<JobEvent, void, undefined> {
  const job = await askJson<Job>(server, `${at("/v1/jobs/{id}", { id })}?include=report&wait=20`, { signal });
  const progress = standing(job);
  if (hasEnded(job)) yield { name: "done", job };
  else if (progress) yield { name: "progress", progress };
}

/** The stream of a job's events, to its end; a problem where it breaks before. */
async function* listen(server: Server, id: string, signal?: AbortSignal): AsyncGenerator<JobEvent, void, undefined> {
  // Not EventSource, which can send no key.
  const answer = await ask(server, `${at("/v1/jobs/{id}/events", { id })}?include=report`, { headers: { accept: "text/event-stream" }, signal });
  const reader = answer.body?.pipeThrough(new TextDecoderStream()).getReader();
  if (!reader) throw Problem.unreachable();
  const parser = new EventParser();
  try {
    for (;;) {
      const timer = setTimeout(() => void reader.cancel().catch(() => undefined), SILENCE);
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

/** Cuts a text that comes in pieces into server-sent events (HTML, 9.2.6), as far as the service uses them. */
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
