import type { Alternative, Artifact, Job, JobReport } from "meshmend-client";
import { optionsOf } from "./advice";

/** The id of the job's own result. */
export const DEFAULT_CHOICE = "default";

/** The results to choose from; empty if there is only one. */
export function choicesOf(job: Job): Alternative[] {
  const offered = job.alternatives?.offered ?? [];
  return offered.length > 1 ? offered : [];
}

/** The picture of a choice. */
export function pictureOf(job: Job, choice: string): Artifact | undefined {
  return job.artifacts[choice === DEFAULT_CHOICE ? "after.png" : `after-${choice}.png`];
}

/** The artifacts that do not depend on the choice. */
const SHARED = ["original", "before.png", "defects.glb", "defects.ply", "defects-preview.glb", "log.txt"];

/** The job as if an alternative were its only result. `report` is the report of the alternative. */
export function withAlternative(job: Job, choice: string, report: JobReport): Job {
  const own: Record<string, string> = {
    model: `model-${choice}`,
    "report.json": `report-${choice}.json`,
    "report-full.json": `report-${choice}.json`,
    "after.png": `after-${choice}.png`,
    "change.glb": `change-${choice}.glb`,
  };
  const names = [...SHARED.map((name) => [name, name] as const), ...Object.entries(own)];
  const artifacts = Object.fromEntries(names.flatMap(([name, source]) => (job.artifacts[source] ? [[name, job.artifacts[source]]] : [])));
  const answer = choicesOf(job).find(({ id }) => id === choice)?.option?.split("=", 2);
  const { alternatives: _, ...options } = optionsOf(job);
  const outcome = report.mode === "repair" ? report.outcome : job.outcome;
  return { ...job, outcome, report, options: { ...options, ...(answer && { [answer[0]!]: answer[1] }) } as Job["options"], artifacts };
}
