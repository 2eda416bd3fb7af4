import type { Job, Options, Report } from "meshmend-client";
import { inMillimetres } from "../units";
import { isOpenSheet, optionsOf } from "./advice";
import { unitOf } from "./summary";

/** The units that a file may be in, as the option `unit` names them. */
export const FILE_UNITS = ["mm", "cm", "in", "m", "ft", "um"] as const;
/** Formats without a unit; other programs read their lengths as millimetres. */
const WITHOUT_UNIT = ["stl", "obj", "ply", "off", "mesh", "zip"];
/** Options that are lengths. */
const LENGTHS = ["thickness", "max_deviation", "max_error", "merge_distance", "stitch_distance", "voxel_size"];

/** The unit that the lengths of the uploaded file were read in. */
export function fileUnit({ unit, before }: Report): string {
  return unit?.scaled_from ?? unit?.used ?? before.print?.unit ?? "mm";
}

/** The sides of the model in millimetres if its file were in `unit`. */
export function sizeIn(report: Report, unit: string): [number, number, number] | null {
  const size = report.before.print?.size_mm;
  const factor = inMillimetres(unit) / inMillimetres(fileUnit(report));
  return size ? (size.map((side) => side * factor) as [number, number, number]) : null;
}

/** A unit that the file may be in, with the size and the median wall of the model in it, in millimetres. */
export interface UnitChoice {
  unit: string;
  size: [number, number, number];
  wall: number | null;
}

/** The units to ask for: the likely ones, best first, and the one that was used. */
export function unitChoices(report: Report): UnitChoice[] {
  const ranked = report.unit_candidates?.ranked ?? [];
  const choices = ranked.slice(0, 2).map(({ unit, size_mm, wall_mm }): UnitChoice => ({ unit, size: size_mm as UnitChoice["size"], wall: wall_mm ?? null }));
  const now = fileUnit(report);
  const size = sizeIn(report, now);
  const isListed = choices.some(({ unit }) => unit === now);
  return isListed || !size ? choices : [...choices, { unit: now, size, wall: null }];
}

/** The unit of the lengths among the options. */
function unitOfOptions(report: Report, options: Options): string {
  return String(options["scale_to"] ?? options["unit"] ?? fileUnit(report));
}

/** A job's options for reading the same file in another unit. A result format without a unit is written in millimetres. */
export function withUnit(job: Job, report: Report, unit: string): Options {
  const before = optionsOf(job);
  const format = report.output?.format ?? report.input.format;
  const scale = unit !== "mm" && WITHOUT_UNIT.includes(format) ? { scale_to: "mm" } : {};
  const options: Options = { ...scale, ...before, unit };
  const factor = inMillimetres(unitOfOptions(report, before)) / inMillimetres(unitOfOptions(report, options));
  for (const name of LENGTHS) if (typeof options[name] === "number") options[name] *= factor;
  return options;
}

/** The state of an open surface: still open, or its new thickness in millimetres. */
export interface OpenSurface {
  is: "open" | "thick" | "base";
  mm: number | null;
}

/** The open surface of a job's model; null if the model was a solid. */
export function openSurfaceOf(job: Job): OpenSurface | null {
  const report = job.report?.mode === "repair" ? job.report : null;
  if (!report) return null;
  const solidified = report.assumptions?.find(({ kind, amount }) => amount != null && (kind === "sheets_thickened" || kind === "bases_added"));
  if (solidified) return { is: solidified.kind === "bases_added" ? "base" : "thick", mm: solidified.amount! * inMillimetres(unitOf(report)) };
  if (isOpenSheet(report)) return { is: "open", mm: null };
  const asked = optionsOf(job);
  const isAsked = asked["open_sheets"] === "thicken" && typeof asked["thickness"] === "number" && !report.verdict?.printable;
  return isAsked ? { is: "thick", mm: Number(asked["thickness"]) * inMillimetres(unitOfOptions(report, asked)) } : null;
}

/** A job's options with a thickness for open surfaces, in millimetres. */
export function withThickness(job: Job, report: Report, mm: number): Options {
  const options = optionsOf(job);
  const kind = openSurfaceOf(job)?.is === "base" ? "base" : "thicken";
  return { ...options, open_sheets: kind, thickness: lengthIn(mm, unitOfOptions(report, options)) };
}

/** A length in a unit, rounded to hide the rounding error of the division. */
export function lengthIn(mm: number, unit: string): number {
  return Number((mm / inMillimetres(unit)).toPrecision(9));
}
