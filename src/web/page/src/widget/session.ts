import { type Capabilities, type Job, type NewJob, type Options, type ProgressEvent, type Server, Problem, announce, cancelJob, capabilities, follow, send, standing, submitWithRetry } from "meshmend-client";
import { DEFAULT_CHOICE } from "../report/alternatives";
import { claimsOf } from "../report/verdict";
import { jobOfChoice } from "../state/job";
import { Store } from "../state/store";
import { type EventSink, sendChosen, sendEnd, sendProgress, sendRefusal, sendUploaded } from "./events";
import type { Tokens } from "./tokens";

/** State of the file; `empty` without a file. */
export type Phase = "empty" | "uploading" | "paused" | "submitting" | "following" | "ended" | "refused";

export interface State {
  phase: Phase;
  name: string;
  bytes: number;
  sent: number;
  progress: ProgressEvent | null;
  job: Job | null;
  problem: Problem | null;
  /** The id of the result that the customer chose among the alternatives. */
  choice: string;
  /** The job as if the chosen result were its only one; null while nothing but the default was chosen. */
  chosen: Job | null;
  /** The service's capabilities, fetched only if the result is not printable. */
  can: Capabilities | null;
}

const EMPTY: State = { phase: "empty", name: "", bytes: 0, sent: 0, progress: null, job: null, problem: null, choice: DEFAULT_CHOICE, chosen: null, can: null };

/** The shop's settings for its jobs, from the attributes. Reading them throws a `Problem` if an attribute is malformed. */
export interface ShopSettings {
  base: string;
  options: Options;
  metadata: Record<string, string>;
  maxBytes: number;
}

/** One file at a time, from drop to result. */
export class Session {
  readonly state = new Store<State>(EMPTY);
  #file: File | null = null;
  /** The service, with the token that submitted the current job. */
  #server: Server | null = null;
  #stop = new AbortController();
  /** The last choice of the customer, whose report may still be loading. */
  #wanted = DEFAULT_CHOICE;

  constructor(
    readonly settings: () => ShopSettings,
    readonly tokens: Tokens,
    readonly sink: EventSink,
  ) {}

  get server(): Server | null {
    return this.#server;
  }

  /** The file of the current job. */
  get file(): File | null {
    return this.#file;
  }

  /** Uploads a file and submits it as a job, with the given options or else with the shop's. */
  take(file: File, options: Options | null = null): void {
    this.#file = file;
    void this.#run({ ...EMPTY, phase: "uploading", name: file.name, bytes: file.size }, (signal) => this.#send(file, options, signal));
  }

  /** Whether customers may choose an option: the shop has not set it. */
  isFree(option: string): boolean {
    try {
      return !(option in this.settings().options);
    } catch {
      return false;
    }
  }

  /** Sends the file from its start again: an upload is one request. */
  resume(): void {
    if (this.#file) this.take(this.#file);
  }

  pause(): void {
    this.#stop.abort();
    this.#change({ phase: "paused", sent: 0 });
  }

  /** Stops the upload, or cancels the job. The end of a canceled job is reported like any other end. */
  async cancel(): Promise<void> {
    const { phase, job } = this.state.value;
    if (phase === "following" && job && this.#server) {
      await cancelJob(this.#server, job.id).catch((error: unknown) => {
        const hasEnded = error instanceof Problem && error.code === "job_finished";
        if (!hasEnded) this.#refuse(error);
      });
      return;
    }
    this.reset();
    sendRefusal(this.sink, null, new Problem(0, "canceled", "", ""));
  }

  /** Submits another job for the same file, with other options. */
  again(options: Options): void {
    const { job, name, bytes } = this.state.value;
    const [file, server] = [this.#file, this.#server];
    if (!job || !file || !server) return;
    void this.#run({ ...EMPTY, phase: "submitting", name, bytes, sent: bytes }, async (signal) => {
      const request: NewJob = { source: { job_id: job.id }, options, metadata: this.settings().metadata };
      const created = await submitWithRetry(server, request, signal).catch((error: unknown) => {
        // Another token cannot see the earlier job, and the service keeps its file only for a limited time.
        const isLost = ["unauthorized", "job_expired", "job_deleted", "job_not_found"];
        if (error instanceof Problem && isLost.includes(error.code)) return null;
        throw error;
      });
      await (created ? this.#followCreated(created, server, signal) : this.#send(file, options, signal));
    });
  }

  /** Takes one of the job's results, once its report is loaded. Nothing is repaired again. Throws a `Problem` if the report is unavailable. */
  async choose(choice: string): Promise<void> {
    const { job } = this.state.value;
    if (!job || !this.#server) return;
    this.#wanted = choice;
    const chosen = await jobOfChoice(this.#server, job, choice);
    if (this.#wanted !== choice || this.state.value.job !== job) return;
    this.state.change((now) => ({ ...now, choice, chosen }));
    sendChosen(this.sink, job, choice);
  }

  reset(): void {
    this.#stop.abort();
    this.#file = null;
    this.state.set(EMPTY);
  }

  /** Stops following while the element is not in the page. The job continues. */
  sleep(): void {
    const { phase } = this.state.value;
    if (phase === "uploading" || phase === "submitting") this.pause();
    else this.#stop.abort();
  }

  /** Follows the job again. */
  wake(): void {
    const { value } = this.state;
    const [server, { job }] = [this.#server, value];
    if (value.phase === "following" && job && server) void this.#run(value, (signal) => this.#follow(job, server, signal));
  }

  async #run(first: State, work: (signal: AbortSignal) => Promise<void>): Promise<void> {
    this.#stop.abort();
    const stop = new AbortController();
    this.#stop = stop;
    this.state.set(first);
    try {
      await work(stop.signal);
    } catch (error) {
      if (!stop.signal.aborted) this.#refuse(error);
    }
  }

  async #send(file: File, other: Options | null, signal: AbortSignal): Promise<void> {
    const { base, options, metadata, maxBytes } = this.settings();
    if (file.size > maxBytes) throw new Problem(413, "payload_too_large", "", "");
    this.#change({ phase: "uploading" });
    const { answer: place, server } = await this.tokens.request(base, signal, (server) => announce(server, file.name, file.size, signal));
    await send(server, place, file, (sent) => this.#change({ sent }), signal);
    this.#change({ phase: "submitting", sent: file.size });
    const request: NewJob = { source: { upload_id: place.id }, options: other ?? options, metadata };
    const created = await this.tokens.request(base, signal, (server) => submitWithRetry(server, request, signal), server);
    await this.#followCreated(created.answer, created.server, signal);
  }

  async #followCreated(job: Job, server: Server, signal: AbortSignal): Promise<void> {
    this.#server = server;
    sendUploaded(this.sink, job);
    this.#change({ phase: "following", job, progress: standing(job) });
    await this.#follow(job, server, signal);
  }

  async #follow(job: Job, server: Server, signal: AbortSignal): Promise<void> {
    const ended = await follow(server, job.id, (progress) => this.#change({ progress }), signal);
    signal.throwIfAborted();
    const can = claimsOf(ended).isPrintable ? null : await capabilities(server).catch(() => null);
    signal.throwIfAborted();
    this.state.change((now) => ({ ...now, phase: "ended", job: ended, progress: null, can }));
    sendEnd(this.sink, ended);
  }

  #change(change: Partial<State>): void {
    this.state.change((now) => ({ ...now, ...change }));
    sendProgress(this.sink, this.state.value);
  }

  #refuse(error: unknown): void {
    const problem = Problem.from(error);
    this.state.change((now) => ({ ...now, phase: "refused", problem }));
    sendRefusal(this.sink, this.state.value.job?.id ?? null, problem);
  }
}
