import type { Inspection, Job, PartAccounting, ObjectReport, Report } from "meshmend-client";
import { type Figures, type Unit, inMillimetres } from "../units";
import type { Words } from "../words/en";

/** The report on one mesh: a whole file, or an object in it. */
type Account = Report | ObjectReport;
type Step = Report["steps"][number];

/** Kinds that are remarks, not defects, and so are never reported as repaired. */
const REMARKS = new Set(["disjoint", "inner_shell", "tiny_part"]);
export function isRemark(kind: string): boolean {
  return REMARKS.has(kind);
}

/** Changes that remove the boundary of a sheet without closing a hole. */
const MADE_SOLID = ["sheets_thickened", "bases_added", "faces_around_open_regions_thickened"];
/** Moves below this share of the model's size are rounding errors. */
const NOTHING = 1e-6;

function counts(inspection: Inspection | null | undefined): Map<string, number> {
  return new Map((inspection?.defects ?? []).map(({ kind, count }) => [kind, count]));
}

/** Describes what a repair did: repaired defects, changed parts, moved surface. Most important first. */
export function repairSummary(report: Account, words: Words, figures: Figures, unit: Unit): string[] {
  if (report.outcome === "already_printable") return [words.untouched];
  if (report.outcome === "unrepairable" && isSame(report)) return [words.handedBack];
  const lines: string[] = [];
  const after = counts(report.after);
  for (const [kind, count] of counts(report.before)) {
    const gone = kind === "hole" ? holesClosed(report, count - (after.get(kind) ?? 0)) : count - (after.get(kind) ?? 0);
    const say = words.fixed[kind];
    if (gone > 0 && say && !REMARKS.has(kind)) lines.push(say(figures.count(gone), gone));
  }
  lines.push(...requestedLines(report, words, figures, unit));
  const part_accounting = report.part_accounting;
  // A cavity with a vent is one with the surface around it, but no parts were united.
  const united = (part_accounting?.united ?? 0) - changed(report, ["voids_vented"]);
  if (united > 1) lines.push(words.united(figures.count(united)));
  const left = part_accounting ? droppedPieces(part_accounting) : 0;
  if (left > 0) lines.push(words.dropped(figures.count(left), left));
  return [...lines, ...surfaceLines(report, words, figures, unit)];
}

/** What was done because options asked for it: thicker walls, vented or filled cavities, struts. */
function requestedLines(report: Account, words: Words, figures: Figures, unit: Unit): string[] {
  const added = stepsOfResult(report).reduce((sum, step) => sum + (step.thickening?.added_volume_mm3 ?? 0), 0);
  return Object.entries(words.requested).flatMap(([kind, say]) => {
    const count = changed(report, [kind]);
    return count > 0 ? [say(figures.count(count), count, figures.volume(added, unit))] : [];
  });
}

/** The steps that made the result. */
function stepsOfResult(report: Account): Step[] {
  const accounts: Account[] = "objects" in report && report.objects && report.objects.length > 0 ? report.objects : [report];
  return accounts.flatMap((account) => account.steps.filter((step) => step.status === "done" && isChosen(account, step.strategy)));
}

/** How often the steps that made the result changed something in one of some ways. */
function changed(report: Account, kinds: string[]): number {
  return stepsOfResult(report)
    .flatMap((step) => step.changed)
    .reduce((sum, { kind, count }) => (kinds.includes(kind) ? sum + count : sum), 0);
}

/** The number of closed holes. Thickening a sheet also removes its boundary, which does not count as a closed hole. */
function holesClosed(report: Account, gone: number): number {
  return changed(report, MADE_SOLID) > 0 ? Math.min(gone, changed(report, ["holes_closed"])) : gone;
}

/** Whether the result has the same surface as the input. */
function isSame(report: Account): boolean {
  const surface = report.changes?.surface;
  return !surface || surface.added.faces + surface.moved.faces + surface.removed.faces === 0;
}

function droppedPieces(part_accounting: PartAccounting): number {
  return part_accounting.duplicate + part_accounting.no_volume + part_accounting.debris;
}

function surfaceLines(report: Account, words: Words, figures: Figures, unit: Unit): string[] {
  const lines: string[] = [];
  const surface = report.changes?.surface;
  const whole = surface ? surface.kept.area + surface.moved.area + surface.added.area : 0;
  if (surface && whole > 0 && surface.added.area / whole >= 0.0005) lines.push(words.added(figures.percent(surface.added.area / whole)));
  const unitInMm = inMillimetres(unitOf(report));
  const voxel = report.steps.find((step) => step.status === "done" && step.voxel_size && isChosen(report, step.strategy))?.voxel_size;
  if (voxel) lines.push(words.remade(figures.length(voxel * unitInMm, unit, 2)));
  const moved = report.changes?.moved?.distance.max;
  if (moved !== undefined) {
    const size = Math.max(...(report.before.print?.size ?? [0]));
    lines.push(moved <= NOTHING * size ? words.notMoved : words.moved(figures.length(moved * unitInMm, unit, 2)));
  }
  return lines;
}

function isChosen(report: Account, strategy: number): boolean {
  return report.candidates.some((candidate) => candidate.chosen && candidate.strategy === strategy);
}

export function unitOf(report: Account): string {
  return report.before.print?.unit ?? "mm";
}

/** The remaining defects of the result, in words; empty if there are none. */
export function remainingDefects(report: Account, words: Words, figures: Figures): string {
  const list = [...counts(report.after)].filter(([kind]) => !REMARKS.has(kind));
  return list
    .map(([kind, count]) => {
      const [one, many] = words.kinds[kind] ?? [kind, kind];
      return `${figures.count(count)} ${count === 1 ? one : many}`;
    })
    .join(", ");
}

export function unitOfJob(job: Job): string {
  return job.report?.mode === "repair" ? unitOf(job.report) : "mm";
}

/** The up axis of a job's model: as its format defines, else z, as on a printer. */
export function upOfJob(job: Job): "y" | "z" {
  return (job.report?.mode === "repair" && job.report.unit?.up) || "z";
}
