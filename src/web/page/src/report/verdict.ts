import type { Artifact, Job, Outcome, Report } from "meshmend-client";

type Verdict = NonNullable<Report["verdict"]>;
/** A property that the service verified on the file's bytes. */
export type Property = Verdict["proven"][number];

/** What the page and the widget may claim about a job's model. */
export interface Claims {
  tone: "good" | "fair" | "bad";
  /** The key of the title among the texts for outcomes. */
  title: Outcome | "not_print_ready" | "flagged" | "failed" | "canceled" | "expired";
  isPrintable: boolean;
  /** The verified properties of a printable file; otherwise empty. */
  proven: Property[];
  /** Whether the job has no model because its result does not meet the option `require`. */
  isRefused: boolean;
  model: Artifact | null;
  /** The uploaded file, if the repair did not improve it. */
  original: Artifact | null;
}

/** Whether an outcome means printable; for lists and single objects, which have no report. */
export function isPrintable(outcome: Outcome | null): boolean {
  return outcome === "repaired" || outcome === "already_printable" || outcome === "printable";
}

/** The codes of jobs whose result does not meet the option `require`. */
const REFUSALS = ["not_printable", "not_print_ready"];

/** Derives the claims about a job's model from the verdict in its report. */
export function claimsOf(job: Job): Claims {
  const report = job.report?.mode === "repair" ? job.report : null;
  // Reports of earlier versions have no verdict, so nothing is claimed.
  const verdict: Partial<Verdict> | undefined = report?.verdict;
  const isGood = job.status === "succeeded" && (verdict?.printable ?? isPrintable(job.outcome));
  const isRefused = REFUSALS.includes(job.problem?.code ?? "");
  return {
    tone: isGood ? "good" : job.status === "failed" ? "bad" : "fair",
    title: titleOf(job, verdict?.passes ?? false),
    isPrintable: isGood,
    proven: isGood ? (verdict?.proven ?? []) : [],
    isRefused,
    model: job.artifacts["model"] ?? null,
    original: job.artifacts["original"] ?? null,
  };
}

function titleOf({ status, outcome, problem }: Job, passes: boolean): Claims["title"] {
  if (status === "failed") return problem?.code === "not_printable" || problem?.code === "not_print_ready" ? problem.code : "failed";
  if (status !== "succeeded" || !outcome) return status === "canceled" ? "canceled" : "expired";
  return outcome === "partially_repaired" && passes ? "flagged" : outcome;
}
