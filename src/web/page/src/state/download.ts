import { type Artifact, type Job, Problem, fetchArtifact, follow, newKey, submit } from "meshmend-client";
import { optionsOf } from "../report/advice";
import { claimsOf } from "../report/verdict";
import { server } from "./server";

/** Lets the browser save a file of a job. If a key is required, the page fetches the file, because links cannot send a key. */
export async function save(artifact: Artifact): Promise<void> {
  if (!server.key()) return click(server.base + artifact.href, artifact.filename);
  const bytes = await fetchArtifact(server, artifact);
  const address = URL.createObjectURL(new Blob([bytes], { type: artifact.media_type }));
  click(address, artifact.filename);
  setTimeout(() => URL.revokeObjectURL(address), 60_000);
}

function click(href: string, name: string): void {
  const link = document.createElement("a");
  link.href = href;
  link.download = name;
  link.click();
}

/**
 * Converts a result to another format. A printable result is only rewritten. Otherwise the uploaded file is repaired again with the same
 * options, because converting an unfinished result would repair it further. The result of an alternative is repaired again too, because
 * only a job's own result can be the source of another job.
 */
export async function convert(job: Job, format: string, isAlternative: boolean, signal: AbortSignal): Promise<Artifact> {
  const whole = claimsOf(job).isPrintable && !isAlternative;
  const { alternatives: _, ...options } = optionsOf(job);
  const made = await submit(
    server,
    {
      source: whole ? { job_id: job.id, file: "model" } : { job_id: job.id },
      options: whole ? { output: format, pictures: false } : { ...options, output: format },
      name: job.input.name,
    },
    newKey(),
    signal,
  );
  const ended = await follow(server, made.id, () => undefined, signal);
  const model = ended.artifacts["model"];
  if (!model) throw new Problem(0, ended.problem?.code ?? "unexplained", ended.problem?.title ?? "", ended.problem?.detail ?? "");
  return model;
}
