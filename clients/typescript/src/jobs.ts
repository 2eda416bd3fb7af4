import { type Server, ask, askJson, at, query } from "./http.js";
import { DamagedDownload, Problem } from "./problem.js";
import { patiently } from "./retry.js";
import type { Artifact, Capabilities, Job, JobPage, Options, Readiness, Source, Status } from "./shapes.js";

export function capabilities(server: Server, signal?: AbortSignal): Promise<Capabilities> {
  return askJson(server, at("/v1/capabilities"), { signal });
}

/** What rides along with a job. */
export interface Notes {
  /** Your own notes, which come back with the job. */
  metadata?: Record<string, string> | undefined;
  /** An address to tell of the job's end. */
  callback_url?: string | undefined;
}

/** A job of a file that the service has: an upload, or a file of an earlier job. */
export interface NewJob extends Notes {
  source: Source;
  options: Options;
  name?: string;
}

/** How a submission is sent. */
export interface Submission {
  /** The same key makes no second job, so that it may be sent again when the answer was lost. */
  once: string;
  /** Whether the work is done even where an earlier job has the result. */
  fresh?: boolean | undefined;
  signal?: AbortSignal | undefined;
}

function submission({ once, fresh, signal }: Submission): { method: string; headers: Record<string, string>; signal: AbortSignal | undefined } {
  return { method: "POST", headers: { "idempotency-key": once, ...(fresh && { "cache-control": "no-cache" }) }, signal };
}

/** Makes a job of a file that the service has. */
export function submit(server: Server, job: NewJob, once: string, signal?: AbortSignal, fresh?: boolean): Promise<Job> {
  return askJson(server, at("/v1/jobs"), { ...submission({ once, fresh, signal }), json: job });
}

/** Longest time that `submitSurely` goes on, in milliseconds. */
const SURELY = 20_000;

/** The same, sent again with the same key where the answer was lost or the service is busy. */
export function submitSurely(server: Server, job: NewJob, signal?: AbortSignal): Promise<Job> {
  const once = newKey();
  return patiently(() => submit(server, job, once, signal), { within: SURELY, signal });
}

/** Makes a job of files that are sent with it. */
export function submitFiles(server: Server, files: readonly File[], options: Options, notes: Notes, how: Submission): Promise<Job> {
  const form = new FormData();
  form.set("options", JSON.stringify(options));
  if (notes.metadata) form.set("metadata", JSON.stringify(notes.metadata));
  if (notes.callback_url) form.set("callback_url", notes.callback_url);
  for (const file of files) form.append("file", file);
  return askJson(server, at("/v1/jobs"), { ...submission(how), form });
}

/** A key for `submit` that nobody else has, where pages that came over plain HTTP have no `randomUUID` too. */
export function newKey(): string {
  return Array.from(crypto.getRandomValues(new Uint8Array(16)), (byte) => byte.toString(16).padStart(2, "0")).join("");
}

/** Whether a job's model can be printed as it is, or of an analysis every file. */
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
  // Pictures have no hash, and pages that came over plain HTTP have nothing to hash with.
  const hash = artifact.sha256;
  if (hash && globalThis.crypto.subtle && hex(await crypto.subtle.digest("SHA-256", bytes)) !== hash) throw damaged(artifact);
  return bytes;
}

function hex(bytes: ArrayBuffer): string {
  return Array.from(new Uint8Array(bytes), (byte) => byte.toString(16).padStart(2, "0")).join("");
}

export function damaged(artifact: Artifact): DamagedDownload {
  return new DamagedDownload(`What came for '${artifact.filename}' is not what the job names.`);
}

/** How the service is; also where it says that it is not ready. */
export async function readiness(server: Server): Promise<Readiness> {
  const answer = await fetch(server.base + at("/readyz"), { credentials: "omit" });
  return (await answer.json()) as Readiness;
}

export async function metrics(server: Server): Promise<string> {
  return (await ask(server, at("/metrics"))).text();
}
