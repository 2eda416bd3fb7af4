import type { Report } from "meshmend-client";
import { type Figures, type Unit, inMillimetres } from "../units";
import type { Words } from "../words/en";
import { unitOf } from "./summary";

type Flag = Report["red_flags"][number];
type Assumption = NonNullable<Report["assumptions"]>[number];

/** Most printers cannot print thinner walls; in millimetres. */
export const LEAST_WALL_MM = 0.8;

/** A remark on a result for the user. `isEnglish` if the text comes from the service and has no translation. */
export interface Remark {
  key: string;
  text: string;
  isEnglish: boolean;
  /** The option that changes an assumption, as `name=value`. */
  option: string | null;
}

/** Flags with counts or lengths; all others have percentages. */
const COUNTS = ["parts_merged", "part_lost", "objects_intersect"];
const LENGTHS = ["deviation"];
/** Assumptions whose amount is a length. */
const THICKNESSES = ["sheets_thickened", "bases_added", "parts_joined"];

/** Red flags of the repair, and walls too thin for most printers. */
export function warningsOf(report: Report, isPrintable: boolean, words: Words, figures: Figures, unit: Unit): Remark[] {
  const unitInMm = inMillimetres(unitOf(report));
  const figure = ({ code }: Flag, value: number): string => {
    if (COUNTS.includes(code)) return figures.count(value);
    return LENGTHS.includes(code) ? figures.length(value * unitInMm, unit, 3) : figures.percent(value / 100);
  };
  const remarks = report.red_flags.map((flag) => {
    const text = words.flagTexts[flag.code]?.({ value: figure(flag, flag.value), limit: figure(flag, flag.threshold) });
    return { key: `${flag.code} ${flag.detail}`, text: text ?? flag.detail, isEnglish: text === undefined, option: null };
  });
  const wall = (report.after ?? report.before).print?.thinnest_wall?.thickness;
  if (isPrintable && wall !== undefined && wall * unitInMm < LEAST_WALL_MM * 0.999) {
    const text = words.thinWarning(figures.length(wall * unitInMm, unit, 2), figures.length(LEAST_WALL_MM, unit, 2));
    remarks.push({ key: "thin_wall", text, isEnglish: false, option: null });
  }
  return remarks;
}

/** Assumptions of the service about what the file does not state. */
export function assumptionsOf(report: Report, words: Words, figures: Figures, unit: Unit): Remark[] {
  return (report.assumptions ?? []).map((assumption) => {
    const { kind, detail, option } = assumption;
    const text = words.assumptionTexts[kind]?.(figuresOf(assumption, report, figures, unit));
    return { key: `${kind} ${detail}`, text: text ?? detail, isEnglish: text === undefined, option: option ?? null };
  });
}

function figuresOf({ kind, count, amount, share_pct }: Assumption, report: Report, figures: Figures, unit: Unit) {
  const unitInMm = inMillimetres(unitOf(report));
  return {
    n: figures.count(count),
    k: count,
    amount: amount != null && THICKNESSES.includes(kind) ? figures.length(amount * unitInMm, unit, 2) : "",
    share: share_pct == null ? "" : figures.percent(share_pct / 100),
    unit: unitOf(report),
  };
}

/** Warnings of the service, and options that it did not apply. */
export function notesOf(report: Report, words: Words): Remark[] {
  const warnings = (report.warnings ?? []).map((text) => ({ key: text, text: sentence(text), isEnglish: true, option: null }));
  const options = (report.options_not_applied ?? []).map(({ option, value, reason }) => {
    const text = `${words.notApplied(`${option}=${value}`)} ${sentence(reason)}`;
    return { key: `${option} ${reason}`, text, isEnglish: true, option: null };
  });
  return [...warnings, ...options];
}

/** Makes a text of the service a sentence: capital letter and final period. */
function sentence(text: string): string {
  const whole = text.charAt(0).toUpperCase() + text.slice(1);
  return /[.!?]$/.test(whole) ? whole : `${whole}.`;
}

/** A job's options with one more option, given as `name=value`. An operator is appended to its list. */
export function withOption(options: Record<string, unknown>, option: string): Record<string, unknown> {
  const [name = "", value = ""] = option.split("=", 2);
  const before = options[name];
  if (name === "with" || name === "without") return { ...options, [name]: [...(Array.isArray(before) ? before : []), value] };
  const number = Number(value);
  return { ...options, [name]: value !== "" && Number.isFinite(number) ? number : value };
}
