import type { Job, Problem } from "meshmend-client";
import { claimsOf } from "../report/verdict";
import type { MeshmendUploadEventMap, Outcome } from "./meshmend-upload";
import { metricsOf } from "./metrics";
import type { State } from "./session";

const ENDS = ["succeeded", "failed", "canceled", "expired"] as const;

/** Who tells the shop's page of events. */
export interface Teller {
  tell<K extends keyof MeshmendUploadEventMap>(type: K, detail: MeshmendUploadEventMap[K]["detail"]): void;
  /** What the customer reads of a problem. */
  explain(code: string, title: string): string;
}

/** An outcome of a repair; the widget asks for nothing else. */
function outcomeOf(job: Job): Outcome | null {
  return job.outcome as Outcome | null;
}

export function tellOfUpload(teller: Teller, job: Job): void {
  teller.tell("uploaded", { jobId: job.id, status: job.status, outcome: outcomeOf(job), name: job.input.name, bytes: job.input.bytes });
}

export function tellOfProgress(teller: Teller, { phase, job, sent, bytes, progress }: State): void {
  if (phase !== "uploading" && phase !== "following") return;
  const status = phase === "uploading" ? phase : progress?.status === "running" ? "running" : "queued";
  teller.tell("progress", {
    jobId: job?.id ?? null,
    status,
    outcome: null,
    sent,
    bytes,
    stage: progress?.stage ?? null,
    percent: progress?.percent ?? 0,
    queuePosition: progress?.queue_position ?? null,
  });
}

export function tellOfEnd(teller: Teller, job: Job): void {
  const outcome = outcomeOf(job);
  const metrics = metricsOf(job);
  if (job.status === "succeeded" && claimsOf(job).model && outcome && outcome !== "unrepairable" && metrics) {
    return teller.tell("repaired", { jobId: job.id, status: job.status, outcome, metrics });
  }
  const status = ENDS.find((end) => end === job.status) ?? "failed";
  const code = job.problem?.code ?? (status === "succeeded" ? "unrepairable" : status);
  const message = teller.explain(code, job.problem?.title ?? "");
  teller.tell("failed", { jobId: job.id, status, outcome, code, message, detail: job.problem?.detail ?? "" });
}

export function tellOfRefusal(teller: Teller, jobId: string | null, { code, title, detail }: Problem): void {
  const status = code === "canceled" ? "canceled" : "refused";
  teller.tell("failed", { jobId, status, outcome: null, code, message: teller.explain(code, title), detail });
}
