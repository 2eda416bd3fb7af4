import type { Outcome } from "meshmend-client";

/** Whether a model can be printed: as it is, or as the repair left it. */
export function isPrintable(outcome: Outcome | null): boolean {
  return outcome === "repaired" || outcome === "already_printable" || outcome === "printable";
}
