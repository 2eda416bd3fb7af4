import { type Server, ask, askJson, pause } from "./http";
import { Problem } from "./problem";
import type { Job, ProgressEvent } from "./shapes";

/** Longest wait between two tries to hear of a job, in milliseconds. */
const LONGEST_PAUSE = 15_000;
const ENDED = new Set(["succeeded", "failed", "canceled", "expired"]);

export function hasEnded(job: Pick<Job, "status">): boolean {
  return ENDED.has(job.status);
}

/**
 * Follows a job to its end: by its events, or where a proxy holds those back, by asking. `heard` is told of progress; what it returns is
 * the job as it ended. A connection that breaks is made again.
 */
export async function follow(server: Server, id: string, heard: (event: ProgressEvent) => void, signal: AbortSignal): Promise<Job> {
  const path = `/v1/jobs/${encodeURIComponent(id)}`;
  for (let failures = 0; ; ) {
    try {
      const job = failures % 2 === 0 ? await listen(server, path, heard, signal) : await askJson<Job>(server, `${path}?wait=20`, { signal });
      if (job && hasEnded(job)) return job;
      if (job?.progress) heard({ ...job.progress, status: job.status });
      failures = job ? failures : failures + 1;
    } catch (error) {
      if (signal.aborted || !(error instanceof Problem) || !error.isPassing) throw error;
      failures += 1;
      const wait = error.retryAfter === null ? Math.min(500 * 2 ** Math.min(failures, 6), LONGEST_PAUSE) : error.retryAfter * 1000;
      await pause(wait, signal);
    }
  }
}

/** Reads the stream of a job's events until its end; undefined where it broke off before. */
async function listen(server: Server, path: string, heard: (event: ProgressEvent) => void, signal: AbortSignal): Promise<Job | undefined> {
  // Not EventSource, which can send no key.
  const answer = await ask(server, `${path}/events`, { headers: { accept: "text/event-stream" }, signal });
  const reader = answer.body?.pipeThrough(new TextDecoderStream()).getReader();
  if (!reader) return undefined;
  const parser = new EventParser();
  for (;;) {
    const { done, value } = await reader.read().catch(() => ({ done: true, value: undefined }));
    if (signal.aborted) throw signal.reason;
    for (const event of parser.push(value ?? "")) {
      if (event.name === "done") {
        await reader.cancel();
        return JSON.parse(event.data) as Job;
      }
      if (event.name === "progress") heard(JSON.parse(event.data) as ProgressEvent);
    }
    if (done) return undefined;
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
