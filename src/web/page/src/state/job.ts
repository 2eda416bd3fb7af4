import { type Job, type Server, fetchArtifact, getJob } from "meshmend-client";

type Report = NonNullable<Job["report"]>;

/** The full report of a job; the report in the job itself has shortened lists. Jobs of old versions have only their own report. */
export async function fullReport(server: Server, job: Job, signal?: AbortSignal): Promise<Report | null> {
  const artifact = job.artifacts["report-full.json"];
  if (!artifact) return job.report ?? (await getJob(server, job.id, signal)).report ?? null;
  return JSON.parse(new TextDecoder().decode(await fetchArtifact(server, artifact, signal))) as Report;
}
