import { type Job, type Server, fetchArtifact, getJob } from "meshmend-client";

type Report = NonNullable<Job["report"]>;

/** The whole report of a job, whose own lists have their first items only. A job of before there were whole reports has its own. */
export async function fullReport(server: Server, job: Job, signal?: AbortSignal): Promise<Report | null> {
  const artifact = job.artifacts["report-full.json"];
  if (!artifact) return job.report ?? (await getJob(server, job.id, signal)).report ?? null;
  return JSON.parse(new TextDecoder().decode(await fetchArtifact(server, artifact, signal))) as Report;
}
