import type { Job, Outcome } from "meshmend-client";
import { isPrintable } from "../report/verdict";
import { usePageWords } from "../words/page-locale";

/** The outcome for a model, as a coloured label. */
export function OutcomeChip({ outcome }: { outcome: Outcome }) {
  const { words } = usePageWords();
  return <span class={`chip ${isPrintable(outcome) ? "good" : "fair"}`}>{words.outcomes[outcome]}</span>;
}

/** The status of a job, as a coloured label. */
export function StatusChip({ job }: { job: Job }) {
  const { words } = usePageWords();
  if (job.status === "succeeded" && job.outcome) return <OutcomeChip outcome={job.outcome} />;
  const tone = job.status === "failed" ? "bad" : job.status === "running" || job.status === "queued" ? "busy" : "";
  const text = (job.problem && words.outcomes[job.problem.code]) ?? words.statuses[job.status];
  return <span class={`chip ${tone}`}>{text}</span>;
}
