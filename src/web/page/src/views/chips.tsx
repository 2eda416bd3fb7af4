import type { Job, Outcome } from "meshmend-client";
import { isPrintable } from "../report/outcome";
import { useWords } from "../words/words";

/** What became of a model, in a word and a colour. */
export function OutcomeChip({ outcome }: { outcome: Outcome }) {
  const { words } = useWords();
  return <span class={`chip ${isPrintable(outcome) ? "good" : "fair"}`}>{words.outcomes[outcome]}</span>;
}

/** Where a job stands, in a word and a colour. */
export function StatusChip({ job }: { job: Job }) {
  const { words } = useWords();
  if (job.status === "succeeded" && job.outcome) return <OutcomeChip outcome={job.outcome} />;
  const tone = job.status === "failed" ? "bad" : job.status === "running" || job.status === "queued" ? "busy" : "";
  return <span class={`chip ${tone}`}>{words.statuses[job.status]}</span>;
}
