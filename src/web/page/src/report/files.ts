import type { Artifact, Job } from "meshmend-client";

/** The size of a job's file in bytes; 0 if the service does not state it, as for pictures. */
export function weightOf(job: Job, name: string): number {
  const artifact: Partial<Artifact> | undefined = job.artifacts[name];
  return artifact?.bytes ?? 0;
}
