import { type JobEvent, events, follow, hasEnded } from "./events.js";
import { type Server, ask, askJson, at } from "./http.js";
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
  profiles,
  submit,
  submitFiles,
} from "./jobs.js";
import { JobFailed, Problem } from "./problem.js";
import { retryWithBackoff } from "./retry.js";
import type {
  AnalyzeOptions,
  AnalyzedJob,
  Artifact,
  BrowserToken,
  Capabilities,
  Job,
  JobOptions,
  NewBrowserToken,
  ProcessLimits,
  ProcessProfile,
  ProgressEvent,
  RepairOptions,
  RepairedJob,
  Status,
  Upload,
} from "./shapes.js";
import { announce, send } from "./uploads.js";
import { Webhooks } from "./webhooks.js";

export interface ClientOptions {
  /** The API key or browser token, or a function that returns it for each request. */
  key?: string | (() => string | null) | undefined;
  /** Time in milliseconds for a request with all its retries. */
  timeout?: number;
}

/** A model to send: a file of a page, a file on the disk (`fileAt`), or bytes. */
export type Model = File | Blob | ArrayBuffer | Uint8Array<ArrayBuffer>;

/** A job, or its id. */
export type JobRef = string | Pick<Job, "id">;

function idOf(job: JobRef): string {
  return typeof job === "string" ? job : job.id;
}

/** Options of every call. */
export interface Call {
  /** Aborts the call. */
  signal?: AbortSignal | undefined;
  /** Time limit of the call in milliseconds with all its retries; for `repair`, `analyze` and `wait` including the job. */
  timeout?: number | undefined;
}

/** Options of a submission. */
export interface Submit extends Call {
  /** Submitting again with the same key creates no second job. By default each call has a new key. */
  idempotencyKey?: string;
  metadata?: Notes["metadata"];
  /** URL that receives a webhook when the job ends. */
  callbackUrl?: string;
  /** Whether to ignore the stored result of an earlier job. */
  fresh?: boolean;
  /** Name of a model that is sent as bytes. */
  name?: string;
}

export interface Wait extends Call {
  /** Receives the progress of the job. */
  onProgress?: (progress: ProgressEvent) => void;
}

/** Default time limit of a job in milliseconds, from its submission to its end. */
const RUN = 900_000;
/** Time limit in milliseconds to cancel a job after its caller gave up. */
const CANCEL_TIMEOUT = 5_000;

/** A client of one service. */
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

  /** Repairs a file: submits it, waits until the job ends, and returns the job. Throws `JobFailed` if the job did not succeed. */
  async repair(file: Model, options: RepairOptions = {}, how: Submit & Wait = {}): Promise<RepairedJob> {
    return (await this.#run(file, { ...options, mode: "repair" }, how)) as RepairedJob;
  }

  /** Analyses one or several files without changing them, and returns the job like `repair`. */
  async analyze(files: Model | readonly Model[], options: AnalyzeOptions = {}, how: Submit & Wait = {}): Promise<AnalyzedJob> {
    return (await this.#run(files, { ...options, mode: "analyze" }, how)) as AnalyzedJob;
  }

  /** Submits one or several files as a job, and returns without waiting for the job. */
  submit(files: Model | readonly Model[], options: JobOptions = {}, how: Submit = {}): Promise<Job> {
    const { idempotencyKey: once = newKey(), metadata, callbackUrl: callback_url, fresh, name, signal } = how;
    const all = Array.isArray(files) ? (files as readonly Model[]) : [files as Model];
    const sent = all.map((model) => asFile(model, name));
    return this.#retry(() => submitFiles(this, sent, options, { metadata, callback_url }, { once, fresh, signal }), how);
  }

  /** Submits a job for a file on the service: an upload, or a file of an earlier job. */
  submitFrom(source: NewJob["source"], options: JobOptions = {}, how: Submit = {}): Promise<Job> {
    const { idempotencyKey: once = newKey(), metadata, callbackUrl: callback_url, fresh, name, signal } = how;
    const job: NewJob = { source, options, metadata, callback_url, ...(name !== undefined && { name }) };
    return this.#retry(() => submit(this, job, once, signal, fresh), how);
  }

  /**
   * Uploads a file without a job, directly to the bucket if the service uses one. `submitFrom` creates the job. In browsers, `sent` receives
   * the number of sent bytes.
   */
  async upload(file: Model, how: Call & { name?: string; sent?: (bytes: number) => void } = {}): Promise<Upload> {
    const model = asFile(file, how.name);
    const place = await this.#retry(() => announce(this, model.name, model.size, how.signal), how);
    const put = async (tries: number): Promise<void> => {
      try {
        await send(this, place, model, how.sent ?? (() => undefined), how.signal);
      } catch (error) {
        // The first attempt arrived, and only its response was lost.
        if (tries === 1 || !(error instanceof Problem) || error.code !== "upload_used") throw error;
      }
    };
    await this.#retry(put, how);
    return place;
  }

  get(job: JobRef, how: Call = {}): Promise<Job> {
    return this.#retry(() => getJob(this, idOf(job), how.signal), how);
  }

  /** Waits until a job ends, and returns it whatever its status. The job goes on after a timeout (`TimeoutError`) or an abort. */
  async wait(job: JobRef, { onProgress, signal, timeout = RUN }: Wait = {}): Promise<Job> {
    return follow(this, idOf(job), onProgress ?? (() => undefined), withTimeout(signal, timeout));
  }

  /** Yields a job's progress, and at the end the job. Reconnects after a lost connection. */
  events(job: JobRef, how: Pick<Call, "signal"> = {}): AsyncGenerator<JobEvent, void, undefined> {
    return events(this, idOf(job), how.signal);
  }

  /** Yields all jobs without their reports, newest first. */
  async *list({ status = "", pageSize = 50, ...how }: Call & { status?: Status | ""; pageSize?: number } = {}): AsyncGenerator<Job, void, undefined> {
    for (let cursor: string | null = null; ; ) {
      const page = await this.#retry(() => listJobs(this, status, cursor, pageSize, how.signal), how);
      yield* page.jobs;
      if (!page.next) return;
      cursor = page.next;
    }
  }

  cancel(job: JobRef, how: Call = {}): Promise<Job> {
    return this.#retry(() => cancelJob(this, idOf(job), how.signal), how);
  }

  /** Deletes a job's files and its report. */
  delete(job: JobRef, how: Call = {}): Promise<void> {
    return this.#retry(() => deleteJob(this, idOf(job), how.signal), how);
  }

  /** Downloads a file of a job, such as `report.json`, and verifies its SHA-256. */
  async download(job: Job, name = "model", how: Call = {}): Promise<Uint8Array<ArrayBuffer>> {
    const artifact = artifactOf(job, name);
    return new Uint8Array(await this.#retry(() => fetchArtifact(this, artifact, how.signal), how));
  }

  capabilities(how: Call = {}): Promise<Capabilities> {
    return this.#retry(() => capabilities(this, how.signal), how);
  }

  /** Lists the built-in process profiles, then your own. */
  profiles(how: Call = {}): Promise<ProcessProfile[]> {
    return this.#retry(() => profiles(this, how.signal), how);
  }

  /** Creates or replaces a process profile of your own. */
  setProfile(name: string, limits: ProcessLimits, how: Call = {}): Promise<ProcessProfile> {
    return this.#retry(() => askJson(this, at("/v1/profiles/{name}", { name }), { method: "PUT", json: limits, signal: how.signal }), how);
  }

  /** Deletes a process profile of your own. */
  async deleteProfile(name: string, how: Call = {}): Promise<void> {
    await this.#retry(() => ask(this, at("/v1/profiles/{name}", { name }), { method: "DELETE", signal: how.signal }), how);
  }

  /** Creates a token for your web page. The token gives access only to the jobs that it created. */
  browserToken(asked: NewBrowserToken, how: Call = {}): Promise<BrowserToken> {
    return this.#retry(() => askJson(this, at("/v1/browser-tokens"), { method: "POST", json: asked, signal: how.signal }), how);
  }

  async #run(files: Model | readonly Model[], options: JobOptions, how: Submit & Wait): Promise<Job> {
    const { timeout = RUN, onProgress = () => undefined } = how;
    const signal = withTimeout(how.signal, timeout);
    let job = await this.submit(files, options, { ...how, signal, timeout });
    try {
      // Also for an ended job: a job with a reused result has no report in this response.
      job = await follow(this, job.id, onProgress, signal);
    } catch (error) {
      // The job may have ended in the meantime, or the service may be unreachable.
      if (!hasEnded(job)) await cancelJob(this, job.id, AbortSignal.timeout(CANCEL_TIMEOUT)).catch(() => undefined);
      throw error;
    }
    if (job.status !== "succeeded") throw new JobFailed(job);
    return job;
  }

  #retry<T>(work: (tries: number) => Promise<T>, { timeout = this.#timeout, signal }: Call): Promise<T> {
    return retryWithBackoff(work, { within: timeout, signal });
  }
}

/** Returns a job's file by its name. */
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

