import type { Capabilities, Job, Options, Report } from "meshmend-client";
import { claimsOf, isPrintable } from "./verdict";

/** Something to try with a job that did not come out whole: other options, and which texts tell of it. */
export interface Try {
  name: "tryBase" | "tryRemesh" | "tryLonger" | "tryAgain";
  options: Options;
}

/** Seconds that a second try of a job that ran out of time is given. */
const LONGER_S = 600;

/** What may help with a job that failed or was not repaired, the most promising first. */
export function tries(job: Job, can: Capabilities | null): Try[] {
  const list: Try[] = [];
  const blender = can?.tiers.some((tier) => tier.tier === 3 && tier.available) ?? false;
  if (job.status === "failed" && !isUnfinished(job)) {
    const code = job.problem?.code;
    if (code === "deadline_exceeded") list.push({ name: "tryLonger", options: { ...own(job), deadline_s: LONGER_S } });
    if (code === "crashed" || code === "worker_lost" || code === "internal") list.push({ name: "tryAgain", options: own(job) });
    return list;
  }
  if (job.report?.mode !== "repair" || !isUnfinished(job)) return list;
  if (isOpenSheet(job.report)) {
    list.push({ name: "tryBase", options: { ...own(job), open_sheets: "base" } });
  } else if (blender && own(job)["preset"] !== "blender-remesh") {
    list.push({ name: "tryRemesh", options: { ...own(job), preset: "blender-remesh", max_tier: 3 } });
  }
  return list;
}

/** Whether a repair ran to its end and its result is not printable, handed out or not. */
export function isUnfinished(job: Job): boolean {
  const hasEnded = job.status === "succeeded" || claimsOf(job).isRefused;
  return hasEnded && job.report?.mode === "repair" && !isPrintable(job.report.outcome);
}

/** A model that is nothing but surface without an inside: it has no closed part, and no repair made one. */
export function isOpenSheet(report: Report): boolean {
  return report.outcome === "unrepairable" && !report.before.closed && (report.options?.["open_sheets"] ?? "auto") === "auto";
}

/** Whether a job repairs; a service may leave out the mode, which is then this one. */
export function isRepair(job: Job): boolean {
  return (own(job)["mode"] ?? "repair") === "repair";
}

/** What a job was asked for, as it can be asked again. */
export function own(job: Job): Options {
  return Object.fromEntries(Object.entries(job.options).filter(([, value]) => value !== null));
}
