import type { Inspection, Report } from "meshmend-client";
import { unitOf } from "../report/summary";
import { settings } from "../state/settings";
import { type Figures, type Unit, inMillimetres } from "../units";
import type { PageWords as Words } from "../words/page-locale";
import { usePageWords } from "../words/page-locale";
import { Facts } from "./facts";
import { StepsTable } from "./steps-table";
import { useStore } from "./use-store";

type Row = [string, string, string];

/** A table of all measures. */
export function Numbers({ report }: { report: Report }) {
  const { words, figures } = usePageWords();
  const { unit } = useStore(settings);
  const unitInMm = inMillimetres(unitOf(report));
  return (
    <details class="numbers card">
      <summary>{words.numbers}</summary>
      <div class="columns">
        <div class="scroll">
          <table>
            <thead>
              <tr>
                <th scope="col">{words.measure}</th>
                <th scope="col">{words.before}</th>
                <th scope="col">{words.after}</th>
              </tr>
            </thead>
            <tbody>
              {rows(report.before, report.after, words, figures, unitInMm, unit).map(([name, before, after]) => (
                <tr key={name} class={before !== after ? "differs" : undefined}>
                  <th scope="row">{name}</th>
                  <td>{before}</td>
                  <td>{after}</td>
                </tr>
              ))}
            </tbody>
          </table>
        </div>
        <Changes report={report} unitInMm={unitInMm} />
      </div>
      <StepsTable report={report} />
    </details>
  );
}

function rows(before: Inspection, after: Inspection | null, words: Words, figures: Figures, unitInMm: number, unit: Unit): Row[] {
  const row = (name: keyof Words["measures"], format: (inspection: Inspection) => string): Row => [words.measures[name], format(before), after ? format(after) : "–"];
  const count = (name: "faces" | "vertices" | "parts" | "boundary_edges" | "boundary_loops" | "non_manifold_edges" | "non_manifold_vertices" | "misoriented_edges" | "degenerate_faces" | "duplicate_faces" | "inverted_parts"): Row =>
    row(name, (inspection) => figures.count(inspection[name]));
  return [
    row("closed", (inspection) => (inspection.closed ? words.yes : words.no)),
    count("boundary_loops"),
    count("boundary_edges"),
    row("intersections", ({ self_intersections: { pairs } }) => (typeof pairs === "number" ? figures.count(pairs) : "–")),
    count("non_manifold_edges"),
    count("non_manifold_vertices"),
    count("misoriented_edges"),
    count("degenerate_faces"),
    count("duplicate_faces"),
    count("inverted_parts"),
    count("parts"),
    count("faces"),
    count("vertices"),
    row("size", (inspection) => inspection.print ? figures.box(inspection.print.size_mm, unit) : "–"),
    row("area", (inspection) => figures.area(inspection.area * unitInMm ** 2, unit)),
    row("volume", (inspection) => (inspection.volume.reliable ? figures.volume(inspection.volume.value * unitInMm ** 3, unit) : "–")),
    row("thinnest", (inspection) => (inspection.print?.thinnest_wall ? figures.length(inspection.print.thinnest_wall.thickness * unitInMm, unit) : "–")),
  ];
}

function Changes({ report, unitInMm }: { report: Report; unitInMm: number }) {
  const { words, figures } = usePageWords();
  const { unit } = useStore(settings);
  const changes = report.changes;
  if (!changes) return null;
  const percent = (value: number | null | undefined): string => (value == null ? "–" : figures.percent(value / 100));
  const share = (name: "kept" | "added" | "removed"): string => {
    const surface = changes.surface?.[name];
    return surface ? `${figures.area(surface.area * unitInMm ** 2, unit)} · ${figures.count(surface.faces)}` : "–";
  };
  const list: [string, string][] = [
    [words.changes.moved, changes.moved ? figures.length(changes.moved.distance.max * unitInMm, unit, 3) : "–"],
    [words.changes.kept, share("kept")],
    [words.changes.added, share("added")],
    [words.changes.removed, share("removed")],
    [words.changes.volume, percent(changes.volume_change_pct)],
    [words.changes.box, percent(changes.bounding_box_change_pct)],
  ];
  return (
    <div>
      <h3>{words.changesTitle}</h3>
      <Facts list={list} look="wide" />
      {report.plan && (
        <p class="aside">
          {words.planReason}: {report.plan.preset}. <span lang="en">{report.plan.reason}</span>
        </p>
      )}
    </div>
  );
}
