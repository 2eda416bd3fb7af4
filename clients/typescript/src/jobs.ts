import { type Server, ask, askJson } from "./http";
import type { Artifact, Capabilities, Job, JobPage, Options, Readiness } from "./shapes";

export function capabilities(server: Server): Promise<Capabilities> {
  return askJson(server, "/v1/capabilities");
}

/** What a job is made of: a file that was uploaded, or a file of an earlier job. */
export type Source = { upload_id: string } | { job_id: string; file?: "input" | "model" };

export interface NewJob {
  source: Source;
  options: Options;
  name?: string;
  metadata?: Record<string, string>;
}

/** Makes a job. The same `once` makes no second one, so that it may be sent again when the answer was lost. */
export function submit(server: Server, job: NewJob, once: string, signal?: AbortSignal): Promise<Job> {
  return askJson(server, "/v1/jobs", {
    method: "POST",
    json: job,
    headers: { "idempotency-key": once },
    ...(signal && { signal }),
  });
}

export function getJob(server: Server, id: string, signal?: AbortSignal): Promise<Job> {
  return askJson(server, `/v1/jobs/${encodeURIComponent(id)}`, signal ? { signal } : {});
}

export function listJobs(server: Server, status: string, cursor: string | null, limit: number): Promise<JobPage> {
  const query = new URLSearchParams({ limit: String(limit) });
  if (status) query.set("status", status);
  if (cursor) query.set("cursor", cursor);
  return askJson(server, `/v1/jobs?${query}`);
}

export function cancelJob(server: Server, id: string): Promise<Job> {
  return askJson(server, `/v1/jobs/${encodeURIComponent(id)}/cancel`, { method: "POST" });
}

export async function deleteJob(server: Server, id: string): Promise<void> {
  await ask(server, `/v1/jobs/${encodeURIComponent(id)}`, { method: "DELETE" });
}

export async function fetchArtifact(server: Server, artifact: Artifact, signal?: AbortSignal): Promise<ArrayBuffer> {
  return (await ask(server, artifact.href, signal ? { signal } : {})).arrayBuffer();
}

/** How the service is; also where it says that it is not ready. */
export async function readiness(server: Server): Promise<Readiness> {
  const answer = await fetch(`${server.base}/readyz`, { credentials: "omit" });
  return (await answer.json()) as Readiness;
}

export async function metrics(server: Server): Promise<string> {
  return (await ask(server, "/metrics")).text();
}
