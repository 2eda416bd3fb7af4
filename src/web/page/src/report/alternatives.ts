import type { Alternative, Artifact, Job, Report } from "meshmend-client";
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

/** The artifacts that depend on the choice. */
const OF_RESULT = /^(model|report|after|change|remaining|thickness)/;

/** The job as if an alternative were its only result. `report` is the report of the alternative. */
export function withAlternative(job: Job, choice: string, report: Report): Job {
  const artifacts = Object.fromEntries(Object.entries(job.artifacts).filter(([name]) => !OF_RESULT.test(name)));
  for (const name of ["model", "report.json", "report-full.json", "after.png", "change.glb"]) {
    // `report-full.json` is the only report of an alternative.
    const own = job.artifacts[name.replace(/(-full)?(\.|$)/, `-${choice}$2`)];
    if (own) artifacts[name] = own;
  }
  const answer = choicesOf(job).find(({ id }) => id === choice)?.option?.split("=", 2);
  const { alternatives: _, ...options } = optionsOf(job);
  return { ...job, outcome: report.outcome, report, options: { ...options, ...(answer && { [answer[0]!]: answer[1] }) } as Job["options"], artifacts };
}
