import type { Job, Options, PrintReadiness, RuleResult } from "meshmend-client";
import type { Figures } from "../units";
import { optionsOf } from "./advice";

/** The readiness of the job's file; null if the job names no process. */
export function readinessOf(job: Job): PrintReadiness | null {
  return readinessIn(job.report);
}

/** The readiness of the single file of a report. */
export function readinessIn(report: Job["report"]): PrintReadiness | null {
  if (!report) return null;
  return (report.mode === "repair" ? report.print_ready : report.files.length === 1 ? report.files[0]!.print_ready : null) ?? null;
}

/** The readiness of each file of an analysis that was checked against a process, with the file's name. */
export function readinessOfFiles(report: Job["report"]): { name: string; readiness: PrintReadiness }[] {
  if (report?.mode !== "analyze") return [];
  return report.files.flatMap(({ name, print_ready }) => (print_ready ? [{ name, readiness: print_ready }] : []));
}

const ORDER: RuleResult["result"][] = ["fail", "undecided", "pass"];

/** The rules of a process: failed rules first, then those that were not decided. */
export function sortedRules({ rules }: PrintReadiness): RuleResult[] {
  return [...rules].sort((a, b) => ORDER.indexOf(a.result) - ORDER.indexOf(b.result));
}

/** Rules with a value in mm³, a number of faces, or a number of bytes; all others have millimetres. */
const VOLUMES = ["part_volume"];
const COUNTS = ["face_count"];
const SIZES = ["file_size"];

/** A limit or a measured value of a rule, in its unit. */
export function ruleValue(rule: string, value: number | null | undefined, figures: Figures): string {
  if (value == null) return "–";
  if (VOLUMES.includes(rule)) return `${figures.number(value, 3)} mm³`;
  if (COUNTS.includes(rule)) return figures.count(value);
  return SIZES.includes(rule) ? figures.bytes(value) : figures.length(value, "mm", 3);
}

/** A job's options with another process, or without one. Limits belong to the process before. */
export function withProcess(options: Options, process: string): Options {
  const { process: _, process_limits: __, ...others } = options;
  if (process) return { ...others, process };
  const { thicken_to_process: ___, ...free } = others;
  return free["require"] === "print_ready" ? { ...free, require: "printable" } : free;
}

/** The options that mend a failed rule; null if no option does that the user may set. */
export function mendingOptions(job: Job, { rule, result, limit }: RuleResult, maySet: (option: string) => boolean = () => true): Options | null {
  if (job.report?.mode !== "repair" || result !== "fail") return null;
  const change = changeFor(rule, limit ?? null);
  return change && Object.keys(change).every(maySet) ? { ...optionsOf(job), ...change } : null;
}

function changeFor(rule: RuleResult["rule"], limit: number | null): Options | null {
  switch (rule) {
    case "supported_wall":
    case "free_wall":
    case "wire":
    case "pin":
      return limit === null ? null : { min_wall: limit };
    case "part_volume":
      return { islands: "drop" };
    case "escape_holes":
      return { voids: "vent" };
    case "build_volume":
      return limit === null ? null : { target_longest_mm: limit };
    case "face_count":
      return limit === null ? null : { max_faces: limit };
    default:
      return null;
  }
}
