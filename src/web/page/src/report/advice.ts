import type { Capabilities, Job, Options, Report } from "meshmend-client";
import { claimsOf, isPrintable } from "./verdict";

/** A suggestion for a job without a printable result: other options, and the key of its text. */
export interface Suggestion {
  name: "tryBase" | "tryRemesh" | "tryLonger" | "tryAgain";
  options: Options;
}

/** Time limit in seconds for retrying a job that exceeded its deadline. */
const LONGER_S = 600;

/** Suggestions for a job that failed or was not repaired, most promising first. */
export function suggestions(job: Job, can: Capabilities | null): Suggestion[] {
  const list: Suggestion[] = [];
  const blender = can?.tiers.some((tier) => tier.tier === 3 && tier.available) ?? false;
  if (job.status === "failed" && !isUnfinished(job)) {
    const code = job.problem?.code;
    if (code === "deadline_exceeded") list.push({ name: "tryLonger", options: { ...optionsOf(job), deadline_s: LONGER_S } });
    if (code === "crashed" || code === "worker_lost" || code === "internal") list.push({ name: "tryAgain", options: optionsOf(job) });
    return list;
  }
  if (job.report?.mode !== "repair" || !isUnfinished(job)) return list;
  if (isOpenSheet(job.report)) {
    list.push({ name: "tryBase", options: { ...optionsOf(job), open_sheets: "base" } });
  } else if (blender && optionsOf(job)["preset"] !== "blender-remesh") {
    list.push({ name: "tryRemesh", options: { ...optionsOf(job), preset: "blender-remesh", max_tier: 3 } });
  }
  return list;
}

/** Whether a repair finished with a result that is not printable, available or not. */
export function isUnfinished(job: Job): boolean {
  const hasEnded = job.status === "succeeded" || claimsOf(job).isRefused;
  return hasEnded && job.report?.mode === "repair" && !isPrintable(job.report.outcome);
}

/** Whether a model is only open surface: it has no closed part, and no repair made one. */
export function isOpenSheet(report: Report): boolean {
  return report.outcome === "unrepairable" && !report.before.closed && (report.options?.["open_sheets"] ?? "auto") === "auto";
}

/** Whether a job is a repair. A missing mode means repair. */
export function isRepair(job: Job): boolean {
  return (optionsOf(job)["mode"] ?? "repair") === "repair";
}

/** The options of a job in a form that can be submitted again. */
export function optionsOf(job: Job): Options {
  return Object.fromEntries(Object.entries(job.options).filter(([, value]) => value !== null));
}
