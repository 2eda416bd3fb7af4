import { type Artifact, type Job, type JobReport, type Report, type Server, fetchArtifact, getJob } from "meshmend-client";
import { DEFAULT_CHOICE, withAlternative } from "../report/alternatives";

/** The full report of a job; the report in the job itself has shortened lists. Jobs of old versions have only their own report. */
export async function fullReport(server: Server, job: Job, signal?: AbortSignal): Promise<JobReport | null> {
  const artifact = job.artifacts["report-full.json"];
  if (!artifact) return job.report ?? (await getJob(server, job.id, signal)).report ?? null;
  return reportIn(server, artifact, signal);
}

/** The job as if the chosen result were its only one. Without a choice, that is the job itself. */
export async function jobOfChoice(server: Server, job: Job, choice: string, signal?: AbortSignal): Promise<Job> {
  if (choice === DEFAULT_CHOICE) return job;
  // Each offered alternative has a report.
  return withAlternative(job, choice, (await reportIn(server, job.artifacts[`report-${choice}.json`]!, signal)) as Report);
}

async function reportIn(server: Server, artifact: Artifact, signal?: AbortSignal): Promise<JobReport> {
  return JSON.parse(new TextDecoder().decode(await fetchArtifact(server, artifact, signal))) as JobReport;
}
