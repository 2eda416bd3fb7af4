import { type Capabilities, type Job, type NewJob, type Options, type ProgressEvent, type Server, Problem, announce, cancelJob, capabilities, follow, send, standing, submitSurely } from "meshmend-client";
import { claimsOf } from "../report/verdict";
import { Store } from "../state/store";
import { type Teller, tellOfEnd, tellOfProgress, tellOfRefusal, tellOfUpload } from "./telling";
import type { Tokens } from "./tokens";

/** How far the file is; `empty` where there is none. */
export type Phase = "empty" | "uploading" | "paused" | "submitting" | "following" | "ended" | "refused";

export interface State {
  phase: Phase;
  name: string;
  bytes: number;
  sent: number;
  progress: ProgressEvent | null;
  job: Job | null;
  problem: Problem | null;
  /** What the service can do, asked for where a model did not come out whole. */
  can: Capabilities | null;
}

const EMPTY: State = { phase: "empty", name: "", bytes: 0, sent: 0, progress: null, job: null, problem: null, can: null };

/** What the shop says of its jobs. Reading it throws a `Problem` where an attribute can't be understood. */
export interface Wishes {
  base: string;
  options: Options;
  metadata: Record<string, string>;
  maxBytes: number;
}

/** One file from drop to result, and then perhaps another. */
export class Session {
  readonly state = new Store<State>(EMPTY);
  #file: File | null = null;
  /** The service with the token that the present job was submitted with. */
  #server: Server | null = null;
  #stop = new AbortController();

  constructor(
    readonly wishes: () => Wishes,
    readonly tokens: Tokens,
    readonly teller: Teller,
  ) {}

  get server(): Server | null {
    return this.#server;
  }

  /** The file of the present job. */
  get file(): File | null {
    return this.#file;
  }

  /** Uploads a file and makes a job of it, with the shop's options or with others. */
  take(file: File, options: Options | null = null): void {
    this.#file = file;
    void this.#run({ ...EMPTY, phase: "uploading", name: file.name, bytes: file.size }, (signal) => this.#send(file, options, signal));
  }

  /** Whether the shop leaves an option to its customers. */
  isFree(option: string): boolean {
    try {
      return !(option in this.wishes().options);
    } catch {
      return false;
    }
  }

  /** Sends the file anew: one request takes the whole of it. */
  resume(): void {
    if (this.#file) this.take(this.#file);
  }

  pause(): void {
    this.#stop.abort();
    this.#change({ phase: "paused", sent: 0 });
  }

  /** Stops what goes on; a job that is made already is canceled, and its end is told as any other's. */
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
    tellOfRefusal(this.teller, null, new Problem(0, "canceled", "", ""));
  }

  /** Makes another job of the file, with other options. */
  again(options: Options): void {
    const { job, name, bytes } = this.state.value;
    const [file, server] = [this.#file, this.#server];
    if (!job || !file || !server) return;
    void this.#run({ ...EMPTY, phase: "submitting", name, bytes, sent: bytes }, async (signal) => {
      const asked: NewJob = { source: { job_id: job.id }, options, metadata: this.wishes().metadata };
      const made = await submitSurely(server, asked, signal).catch((error: unknown) => {
        // With another token the earlier job is not seen, and the service keeps its file for a while only.
        const isLost = ["unauthorized", "job_expired", "job_deleted", "job_not_found"];
        if (error instanceof Problem && isLost.includes(error.code)) return null;
        throw error;
      });
      await (made ? this.#made(made, server, signal) : this.#send(file, options, signal));
    });
  }

  reset(): void {
    this.#stop.abort();
    this.#file = null;
    this.state.set(EMPTY);
  }

  /** Stops asking while nobody looks; a job goes on. */
  sleep(): void {
    const { phase } = this.state.value;
    if (phase === "uploading" || phase === "submitting") this.pause();
    else this.#stop.abort();
  }

  /** Listens to the job again. */
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
    const { base, options, metadata, maxBytes } = this.wishes();
    if (file.size > maxBytes) throw new Problem(413, "payload_too_large", "", "");
    this.#change({ phase: "uploading" });
    const { answer: place, server } = await this.tokens.asking(base, signal, (it) => announce(it, file.name, file.size, signal));
    await send(server, place, file, (sent) => this.#change({ sent }), signal);
    this.#change({ phase: "submitting", sent: file.size });
    const asked: NewJob = { source: { upload_id: place.id }, options: other ?? options, metadata };
    const made = await this.tokens.asking(base, signal, (it) => submitSurely(it, asked, signal), server);
    await this.#made(made.answer, made.server, signal);
  }

  async #made(job: Job, server: Server, signal: AbortSignal): Promise<void> {
    this.#server = server;
    tellOfUpload(this.teller, job);
    this.#change({ phase: "following", job, progress: standing(job) });
    await this.#follow(job, server, signal);
  }

  async #follow(job: Job, server: Server, signal: AbortSignal): Promise<void> {
    const ended = await follow(server, job.id, (progress) => this.#change({ progress }), signal);
    signal.throwIfAborted();
    const can = claimsOf(ended).isPrintable ? null : await capabilities(server).catch(() => null);
    signal.throwIfAborted();
    this.state.change((now) => ({ ...now, phase: "ended", job: ended, progress: null, can }));
    tellOfEnd(this.teller, ended);
  }

  #change(change: Partial<State>): void {
    this.state.change((now) => ({ ...now, ...change }));
    tellOfProgress(this.teller, this.state.value);
  }

  #refuse(error: unknown): void {
    const problem = Problem.from(error);
    this.state.change((now) => ({ ...now, phase: "refused", problem }));
    tellOfRefusal(this.teller, this.state.value.job?.id ?? null, problem);
  }
}
