import { type Server, ask, askJson, at, query } from "./http.js";
import { DamagedDownload, Problem } from "./problem.js";
import { retryWithBackoff } from "./retry.js";
import type { Artifact, Capabilities, Job, JobPage, Options, ProcessProfile, ProcessProfiles, Readiness, Source, Status } from "./shapes.js";

export function capabilities(server: Server, signal?: AbortSignal): Promise<Capabilities> {
  return askJson(server, at("/v1/capabilities"), { signal });
}

/** Lists the built-in process profiles, then those of the key's tenant. */
export async function profiles(server: Server, signal?: AbortSignal): Promise<ProcessProfile[]> {
  return (await askJson<ProcessProfiles>(server, at("/v1/profiles"), { signal })).profiles;
}

/** Additional fields of a submission. */
export interface Notes {
  /** Your own values, which the service returns with the job. */
  metadata?: Record<string, string> | undefined;
  /** URL that receives a webhook when the job ends. */
  callback_url?: string | undefined;
}

/** A submission for a file on the service: an upload, or a file of an earlier job. */
export interface NewJob extends Notes {
  source: Source;
  options: Options;
  name?: string;
}

/** Headers and signal of a submission. */
export interface Submission {
  /** Idempotency key: submitting again with the same key creates no second job. */
  once: string;
  /** Whether to ignore the stored result of an earlier job. */
  fresh?: boolean | undefined;
  signal?: AbortSignal | undefined;
}

function submission({ once, fresh, signal }: Submission): { method: string; headers: Record<string, string>; signal: AbortSignal | undefined } {
  return { method: "POST", headers: { "idempotency-key": once, ...(fresh && { "cache-control": "no-cache" }) }, signal };
}

/** Submits a job for a file on the service. */
export function submit(server: Server, job: NewJob, once: string, signal?: AbortSignal, fresh?: boolean): Promise<Job> {
  return askJson(server, at("/v1/jobs"), { ...submission({ once, fresh, signal }), json: job });
}

/** Time limit of `submitWithRetry` in milliseconds. */
const SUBMIT_TIMEOUT = 20_000;

/** Submits a job, and retries with the same key while the service is unreachable or busy. */
export function submitWithRetry(server: Server, job: NewJob, signal?: AbortSignal): Promise<Job> {
  const once = newKey();
  return retryWithBackoff(() => submit(server, job, once, signal), { within: SUBMIT_TIMEOUT, signal });
}

/** Submits files as a job. */
export function submitFiles(server: Server, files: readonly File[], options: Options, notes: Notes, how: Submission): Promise<Job> {
  const form = new FormData();
  form.set("options", JSON.stringify(options));
  if (notes.metadata) form.set("metadata", JSON.stringify(notes.metadata));
  if (notes.callback_url) form.set("callback_url", notes.callback_url);
  for (const file of files) form.append("file", file);
  return askJson(server, at("/v1/jobs"), { ...submission(how), form });
}

/** Returns a random idempotency key. `crypto.randomUUID` is missing on pages loaded over plain HTTP. */
export function newKey(): string {
  return Array.from(crypto.getRandomValues(new Uint8Array(16)), (byte) => byte.toString(16).padStart(2, "0")).join("");
}

/** Whether a job's model is printable; for an analysis, whether every file is. */
export function isPrintable({ outcome }: Job): boolean {
  return outcome === "already_printable" || outcome === "repaired" || outcome === "printable";
}

export function getJob(server: Server, id: string, signal?: AbortSignal): Promise<Job> {
  return askJson(server, query(at("/v1/jobs/{id}", { id }), { include: "report" }), { signal });
}

export function listJobs(server: Server, status: Status | "", cursor: string | null, limit: number, signal?: AbortSignal): Promise<JobPage> {
  return askJson(server, query(at("/v1/jobs"), { limit, status, cursor }), { signal });
}

export function cancelJob(server: Server, id: string, signal?: AbortSignal): Promise<Job> {
  return askJson(server, at("/v1/jobs/{id}/cancel", { id }), { method: "POST", signal });
}

export async function deleteJob(server: Server, id: string, signal?: AbortSignal): Promise<void> {
  await ask(server, at("/v1/jobs/{id}", { id }), { method: "DELETE", signal });
}

export async function fetchArtifact(server: Server, artifact: Artifact, signal?: AbortSignal): Promise<ArrayBuffer> {
  const answer = await ask(server, artifact.href, { signal });
  const bytes = await answer.arrayBuffer().catch(() => {
    throw signal?.aborted ? signal.reason : Problem.unreachable();
  });
  // Pictures have no SHA-256, and `crypto.subtle` is missing on pages loaded over plain HTTP.
  const hash = artifact.sha256;
  if (hash && globalThis.crypto.subtle && hex(await crypto.subtle.digest("SHA-256", bytes)) !== hash) throw damaged(artifact);
  return bytes;
}

function hex(bytes: ArrayBuffer): string {
  return Array.from(new Uint8Array(bytes), (byte) => byte.toString(16).padStart(2, "0")).join("");
}

export function damaged(artifact: Artifact): DamagedDownload {
  return new DamagedDownload(`The download of '${artifact.filename}' is damaged: its SHA-256 differs from the job's.`);
}

/** Returns the readiness of the service, also if the service is not ready. */
export async function readiness(server: Server): Promise<Readiness> {
  const answer = await fetch(server.base + at("/readyz"), { credentials: "omit" });
  return (await answer.json()) as Readiness;
}

export async function metrics(server: Server): Promise<string> {
  return (await ask(server, at("/metrics"))).text();
}
