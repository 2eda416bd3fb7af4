import type { Alternative, Artifact, Job } from "meshmend-client";

/** The id of the job's own result. */
export const DEFAULT_CHOICE = "default";

/** The results to choose from; empty if there is only one. */
export function choicesOf(job: Job): Alternative[] {
  const offered = job.alternatives?.offered ?? [];
  return offered.length > 1 ? offered : [];
}

/** The model of a choice. */
export function modelOf(job: Job, choice: string): Artifact | undefined {
  return choice === DEFAULT_CHOICE ? (job.artifacts["model"] ?? job.artifacts["original"]) : job.artifacts[`model-${choice}`];
}

/** The picture of a choice. */
export function pictureOf(job: Job, choice: string): Artifact | undefined {
  return job.artifacts[choice === DEFAULT_CHOICE ? "after.png" : `after-${choice}.png`];
}
