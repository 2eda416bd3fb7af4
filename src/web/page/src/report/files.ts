import type { Artifact, Job } from "meshmend-client";

/** The bytes of one of a job's files; 0 where the service does not say, as of pictures. */
export function weightOf(job: Job, name: string): number {
  const artifact: Partial<Artifact> | undefined = job.artifacts[name];
  return artifact?.bytes ?? 0;
}
