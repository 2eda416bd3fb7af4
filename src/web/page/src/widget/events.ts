import type { Job, Problem } from "meshmend-client";
import { claimsOf } from "../report/verdict";
import { choicesOf } from "../report/alternatives";
import type { MeshmendUploadEventMap, Outcome, Point } from "./meshmend-upload";
import { metricsOf } from "./metrics";
import type { State } from "./session";

const ENDS = ["succeeded", "failed", "canceled", "expired"] as const;

/** Sends events to the shop's page. */
export interface EventSink {
  send<K extends keyof MeshmendUploadEventMap>(type: K, detail: MeshmendUploadEventMap[K]["detail"]): void;
  /** The message for the customer about a problem. */
  explain(code: string, title: string): string;
}

/** The outcome of a repair; the widget submits no other jobs. */
function outcomeOf(job: Job): Outcome | null {
  return job.outcome as Outcome | null;
}

export function sendUploaded(sink: EventSink, job: Job): void {
  sink.send("uploaded", { jobId: job.id, status: job.status, outcome: outcomeOf(job), name: job.input.name, bytes: job.input.bytes });
}

export function sendProgress(sink: EventSink, { phase, job, sent, bytes, progress }: State): void {
  if (phase !== "uploading" && phase !== "following") return;
  const status = phase === "uploading" ? phase : progress?.status === "running" ? "running" : "queued";
  sink.send("progress", {
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

export function sendEnd(sink: EventSink, job: Job): void {
  const outcome = outcomeOf(job);
  const metrics = metricsOf(job);
  if (job.status === "succeeded" && claimsOf(job).model && outcome && outcome !== "unrepairable" && metrics) {
    return sink.send("repaired", { jobId: job.id, status: job.status, outcome, metrics });
  }
  const status = ENDS.find((end) => end === job.status) ?? "failed";
  const code = job.problem?.code ?? (status === "succeeded" ? "unrepairable" : status);
  const message = sink.explain(code, job.problem?.title ?? "");
  sink.send("failed", { jobId: job.id, status, outcome, code, message, detail: job.problem?.detail ?? "" });
}

/** Tells the shop's page which of the job's results the customer chose, with its numbers. */
export function sendChosen(sink: EventSink, job: Job, choice: string): void {
  const chosen = choicesOf(job).find(({ id }) => id === choice);
  if (!chosen) return;
  const { option, printable, print_ready: printReady, size_mm: size, volume_mm3: volume, area_mm2: areaMm2, thinnest_wall_mm: wall, weight_g: weight, parts } = chosen;
  const sizeMm: Point | null = size ? [size[0]!, size[1]!, size[2]!] : null;
  sink.send("chosen", { jobId: job.id, choice, option: option ?? null, printable, printReady: printReady ?? null, sizeMm, volumeMm3: volume ?? null, areaMm2, thinnestWallMm: wall ?? null, weightG: weight ?? null, parts });
}

export function sendRefusal(sink: EventSink, jobId: string | null, { code, title, detail }: Problem): void {
  const status = code === "canceled" ? "canceled" : "refused";
  sink.send("failed", { jobId, status, outcome: null, code, message: sink.explain(code, title), detail });
}
