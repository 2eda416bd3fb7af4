import { type JobEvent, events, follow, hasEnded } from "./events.js";
import { type Server, askJson, at } from "./http.js";
import {
  type NewJob,
  type Notes,
  cancelJob,
  capabilities,
  deleteJob,
  fetchArtifact,
  getJob,
  listJobs,
  newKey,
  submit,
  submitFiles,
} from "./jobs.js";
import { JobFailed, Problem } from "./problem.js";
import { patiently } from "./retry.js";
import type {
  AnalyzeOptions,
  AnalyzedJob,
  Artifact,
  BrowserToken,
  Capabilities,
  Job,
  JobOptions,
  NewBrowserToken,
  ProgressEvent,
  RepairOptions,
  RepairedJob,
  Status,
  Upload,
} from "./shapes.js";
import { announce, send } from "./uploads.js";
import { Webhooks } from "./webhooks.js";

export interface ClientOptions {
  /** The API key or browser token, or what tells it anew for each request. */
  key?: string | (() => string | null) | undefined;
  /** Milliseconds within which a request that fails may be tried again. */
  timeout?: number;
}

/** What to send: a file of a page, of a disk (`fileAt`), or bytes. */
export type Model = File | Blob | ArrayBuffer | Uint8Array<ArrayBuffer>;

/** A job, or its id. */
export type JobRef = string | Pick<Job, "id">;

function idOf(job: JobRef): string {
  return typeof job === "string" ? job : job.id;
}

/** How one call is done. */
export interface Call {
  /** Ends the call. */
  signal?: AbortSignal | undefined;
  /** Milliseconds for the call with all its tries; of `repair`, `analyze` and `wait` with the job itself. */
  timeout?: number | undefined;
}

/** How a job is submitted. */
export interface Submit extends Call {
  /** A submission sent again with the same key makes no second job. One is made for each call where none is given. */
  idempotencyKey?: string;
  metadata?: Notes["metadata"];
  /** An address to tell of the job's end. */
  callbackUrl?: string;
  /** Whether the work is done even where an earlier job has the result. */
  fresh?: boolean;
  /** The file's name, where it is bytes. */
  name?: string;
}

export interface Wait extends Call {
  /** Hears how far the job is. */
  onProgress?: (progress: ProgressEvent) => void;
}

/** Milliseconds for a job from its submission to its end, where the call says nothing. */
const RUN = 900_000;
/** Milliseconds for canceling a job that nobody waits for any more. */
const FAREWELL = 5_000;

/** A service, and who asks it. */
export class Client implements Server {
  readonly base: string;
  readonly webhooks: Webhooks;
  readonly #key: () => string | null;
  readonly #timeout: number;

  constructor(base: string, { key, timeout = 60_000 }: ClientOptions = {}) {
    this.base = base.replace(/\/+$/, "");
    this.#key = typeof key === "function" ? key : () => key ?? null;
    this.#timeout = timeout;
    this.webhooks = new Webhooks(this, timeout);
  }

  key(): string | null {
    return this.#key();
  }

  /** Sends a file, waits for the end of its repair, and returns the job. A `JobFailed` is thrown where it ends without an outcome. */
  async repair(file: Model, options: RepairOptions = {}, how: Submit & Wait = {}): Promise<RepairedJob> {
    return (await this.#run(file, { ...options, mode: "repair" }, how)) as RepairedJob;
  }

  /** The same for an analysis of one file or several, which are not changed. */
  async analyze(files: Model | readonly Model[], options: AnalyzeOptions = {}, how: Submit & Wait = {}): Promise<AnalyzedJob> {
    return (await this.#run(files, { ...options, mode: "analyze" }, how)) as AnalyzedJob;
  }

  /** Makes a job of one file or several, and returns as soon as the service has them. */
  submit(files: Model | readonly Model[], options: JobOptions = {}, how: Submit = {}): Promise<Job> {
    const { idempotencyKey: once = newKey(), metadata, callbackUrl: callback_url, fresh, name, signal } = how;
    const all = Array.isArray(files) ? (files as readonly Model[]) : [files as Model];
    const sent = all.map((it) => asFile(it, name));
    return this.#patiently(() => submitFiles(this, sent, options, { metadata, callback_url }, { once, fresh, signal }), how);
  }

  /** Makes a job of a file that the service has: an upload, or a file of an earlier job. */
  submitFrom(source: NewJob["source"], options: JobOptions = {}, how: Submit = {}): Promise<Job> {
    const { idempotencyKey: once = newKey(), metadata, callbackUrl: callback_url, fresh, name, signal } = how;
    const job: NewJob = { source, options, metadata, callback_url, ...(name !== undefined && { name }) };
    return this.#patiently(() => submit(this, job, once, signal, fresh), how);
  }

  /**
   * Sends a file before there is a job of it, straight to the bucket where there is one; `submitFrom` makes the job. `sent` hears how many
   * bytes have gone, in browsers.
   */
  async upload(file: Model, how: Call & { name?: string; sent?: (bytes: number) => void } = {}): Promise<Upload> {
    const it = asFile(file, how.name);
    const place = await this.#patiently(() => announce(this, it.name, it.size, how.signal), how);
    const put = async (tries: number): Promise<void> => {
      try {
        await send(this, place, it, how.sent ?? (() => undefined), how.signal);
      } catch (error) {
        // It had come, and only the answer was lost.
        if (tries === 1 || !(error instanceof Problem) || error.code !== "upload_used") throw error;
      }
    };
    await this.#patiently(put, how);
    return place;
  }

  get(job: JobRef, how: Call = {}): Promise<Job> {
    return this.#patiently(() => getJob(this, idOf(job), how.signal), how);
  }

  /** Waits for a job's end, however it ends. Giving up (a `TimeoutError`, or the signal's reason) leaves it running. */
  async wait(job: JobRef, { onProgress, signal, timeout = RUN }: Wait = {}): Promise<Job> {
    return follow(this, idOf(job), onProgress ?? (() => undefined), withTimeout(signal, timeout));
  }

  /** A job's progress as it comes, and at last the job; a connection that breaks is made again. */
  events(job: JobRef, how: Pick<Call, "signal"> = {}): AsyncGenerator<JobEvent, void, undefined> {
    return events(this, idOf(job), how.signal);
  }

  /** All jobs, the newest first; without their reports. */
  async *list({ status = "", pageSize = 50, ...how }: Call & { status?: Status | ""; pageSize?: number } = {}): AsyncGenerator<Job, void, undefined> {
    for (let cursor: string | null = null; ; ) {
      const page = await this.#patiently(() => listJobs(this, status, cursor, pageSize, how.signal), how);
      yield* page.jobs;
      if (!page.next) return;
      cursor = page.next;
    }
  }

  cancel(job: JobRef, how: Call = {}): Promise<Job> {
    return this.#patiently(() => cancelJob(this, idOf(job), how.signal), how);
  }

  /** Deletes a job's files and its report. */
  delete(job: JobRef, how: Call = {}): Promise<void> {
    return this.#patiently(() => deleteJob(this, idOf(job), how.signal), how);
  }

  /** A file of a job, compared with the hash that the job names: the model, or by name another such as `report.json` or `after.png`. */
  async download(job: Job, name = "model", how: Call = {}): Promise<Uint8Array<ArrayBuffer>> {
    const artifact = artifactOf(job, name);
    return new Uint8Array(await this.#patiently(() => fetchArtifact(this, artifact, how.signal), how));
  }

  capabilities(how: Call = {}): Promise<Capabilities> {
    return this.#patiently(() => capabilities(this, how.signal), how);
  }

  /** A token for a page of yours, which shows only the jobs that were made with it. */
  browserToken(asked: NewBrowserToken, how: Call = {}): Promise<BrowserToken> {
    return this.#patiently(() => askJson(this, at("/v1/browser-tokens"), { method: "POST", json: asked, signal: how.signal }), how);
  }

  async #run(files: Model | readonly Model[], options: JobOptions, how: Submit & Wait): Promise<Job> {
    const { timeout = RUN, onProgress = () => undefined } = how;
    const signal = withTimeout(how.signal, timeout);
    let job = await this.submit(files, options, { ...how, signal, timeout });
    try {
      // Also where it has ended: what was taken from an earlier job has no report here yet.
      job = await follow(this, job.id, onProgress, signal);
    } catch (error) {
      // It may have ended meanwhile, or nobody can tell the service.
      if (!hasEnded(job)) await cancelJob(this, job.id, AbortSignal.timeout(FAREWELL)).catch(() => undefined);
      throw error;
    }
    if (job.status !== "succeeded") throw new JobFailed(job);
    return job;
  }

  #patiently<T>(work: (tries: number) => Promise<T>, { timeout = this.#timeout, signal }: Call): Promise<T> {
    return patiently(work, { within: timeout, signal });
  }
}

/** A file of a job by its name. */
export function artifactOf(job: Job, name: string): Artifact {
  const artifact = job.artifacts[name];
  if (artifact) return artifact;
  throw new RangeError(`The job '${job.id}' has no file '${name}'; it has ${Object.keys(job.artifacts).join(", ") || "none"}.`);
}

function asFile(model: Model, name = "model"): File {
  return model instanceof File ? model : new File([model], name);
}

function withTimeout(signal: AbortSignal | undefined, timeout: number): AbortSignal {
  const late = AbortSignal.timeout(timeout);
  return signal ? AbortSignal.any([signal, late]) : late;
}

