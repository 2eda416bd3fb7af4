import type { Artifact, Job, Outcome, Report } from "meshmend-client";

type Verdict = NonNullable<Report["verdict"]>;
/** A property that the service checked on the file's own bytes. */
export type Property = Verdict["proven"][number];

/** What may be said of a job's model. The page and the widget claim nothing else. */
export interface Claims {
  tone: "good" | "fair" | "bad";
  /** Which of the texts for outcomes and ends is the title. */
  title: Outcome | "flagged" | "failed" | "canceled" | "expired";
  isPrintable: boolean;
  /** What was proven of a printable file; empty for every other. */
  proven: Property[];
  /** Whether the job has no model because only a printable one was asked for. */
  isRefused: boolean;
  model: Artifact | null;
  /** The upload, where nothing made it better. */
  original: Artifact | null;
}

/** Whether an outcome is that of a printable model, where no report is at hand: in lists, and of single objects. */
export function isPrintable(outcome: Outcome | null): boolean {
  return outcome === "repaired" || outcome === "already_printable" || outcome === "printable";
}

/** What may be said of a job's model, by the verdict in its report. */
export function claimsOf(job: Job): Claims {
  const report = job.report?.mode === "repair" ? job.report : null;
  // Reports of earlier versions have no verdict, and prove nothing here.
  const verdict: Partial<Verdict> | undefined = report?.verdict;
  const isGood = job.status === "succeeded" && (verdict?.printable ?? isPrintable(job.outcome));
  const isRefused = job.problem?.code === "not_printable";
  return {
    tone: isGood ? "good" : job.status === "failed" ? "bad" : "fair",
    title: titleOf(job, isRefused, verdict?.passes ?? false),
    isPrintable: isGood,
    proven: isGood ? (verdict?.proven ?? []) : [],
    isRefused,
    model: job.artifacts["model"] ?? null,
    original: job.artifacts["original"] ?? null,
  };
}

function titleOf({ status, outcome }: Job, isRefused: boolean, passes: boolean): Claims["title"] {
  if (status === "failed") return isRefused ? "not_printable" : "failed";
  if (status !== "succeeded" || !outcome) return status === "canceled" ? "canceled" : "expired";
  return outcome === "partially_repaired" && passes ? "flagged" : outcome;
}
