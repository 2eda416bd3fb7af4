import { type Job, type ProgressEvent, type Server, fetchArtifact, follow, getJob, hasEnded } from "meshmend-client";

/** Reads a job with its report. The page and the widget read jobs here and nowhere else. */
export async function readJob(server: Server, id: string, signal?: AbortSignal): Promise<Job> {
  return withReport(server, await getJob(server, id, signal), signal);
}

/** Follows a job to its end, and answers it with its report. */
export async function followJob(server: Server, id: string, heard: (progress: ProgressEvent) => void, signal?: AbortSignal): Promise<Job> {
  return withReport(server, await follow(server, id, heard, signal), signal);
}

/** A service may leave the report out of a job. Then it is read from the job's file `report.json`. */
async function withReport(server: Server, job: Job, signal?: AbortSignal): Promise<Job> {
  const artifact = job.artifacts["report.json"];
  if (job.report || !artifact || !hasEnded(job)) return job;
  try {
    const bytes = await fetchArtifact(server, artifact, signal);
    return { ...job, report: JSON.parse(new TextDecoder().decode(bytes)) as NonNullable<Job["report"]> };
  } catch (error) {
    signal?.throwIfAborted();
    console.warn("The report of the job could not be read:", error);
    return job;
  }
}
