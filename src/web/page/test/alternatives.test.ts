import assert from "node:assert/strict";
import { test } from "node:test";
import type { Job, Report } from "meshmend-client";
import { choicesOf, pictureOf, withAlternative } from "../src/report/alternatives";
import { readinessOfFiles } from "../src/report/print-ready";
import { unitChoices } from "../src/report/settings";
import { THICK_BAND, bandOf, leastWallOf } from "../src/report/wall-thickness";
import { sendChosen } from "../src/widget/events";

const figures = { printable: true, size_mm: [1, 2, 3], volume_mm3: 6, area_mm2: 22, thinnest_wall_mm: 0.5, weight_g: null, parts: 1 };
const offered = [
  { id: "default", is_default: true, ...figures },
  { id: "interior-keep", is_default: false, option: "interior=keep", ...figures, volume_mm3: 2 },
];
const names = ["model", "after.png", "change.glb", "thickness.glb", "defects.glb", "report-full.json", "model-interior-keep", "after-interior-keep.png", "report-interior-keep.json"];
const artifacts = Object.fromEntries(names.map((name) => [name, { href: `/${name}` }]));
const options = { alternatives: true, output: "stl" };
const job = { id: "job_1", outcome: "repaired", alternatives: { offered }, options, artifacts } as unknown as Job;

test("a job offers a choice only if there is more than one result", () => {
  assert.equal(choicesOf(job).length, 2);
  assert.deepEqual(choicesOf({ alternatives: { offered: [offered[0]] } } as unknown as Job), []);
  assert.deepEqual(choicesOf({} as Job), []);
});

test("each choice has its own picture", () => {
  assert.deepEqual([pictureOf(job, "default")?.href, pictureOf(job, "interior-keep")?.href], ["/after.png", "/after-interior-keep.png"]);
});

test("a chosen result is shown with its own report, option and files, and with no drawing of the default result", () => {
  const report = { mode: "repair", outcome: "partially_repaired" } as unknown as Report;
  const chosen = withAlternative(job, "interior-keep", report);
  assert.deepEqual([chosen.outcome, chosen.report, chosen.options], ["partially_repaired", report, { output: "stl", interior: "keep" }]);
  const files = Object.fromEntries(Object.entries(chosen.artifacts).map(([name, { href }]) => [name, href]));
  const own = { model: "/model-interior-keep", "report.json": "/report-interior-keep.json", "report-full.json": "/report-interior-keep.json", "after.png": "/after-interior-keep.png" };
  assert.deepEqual(files, { "defects.glb": "/defects.glb", ...own });
});

test("the shop's page learns which result the customer chose", () => {
  const sent: unknown[] = [];
  const sink = { send: (type: string, detail: unknown) => sent.push([type, detail]), explain: () => "" };
  sendChosen(sink, job, "interior-keep");
  sendChosen(sink, job, "other");
  const detail = { jobId: "job_1", choice: "interior-keep", option: "interior=keep", printable: true, printReady: null, sizeMm: [1, 2, 3], volumeMm3: 2, areaMm2: 22, thinnestWallMm: 0.5, weightG: null, parts: 1 };
  assert.deepEqual(sent, [["chosen", detail]]);
});

test("the page asks for the likely units and for the one that was used", () => {
  const ranked = ["in", "m", "cm"].map((unit) => ({ unit, size_mm: [25.4, 25.4, 25.4], wall_mm: 2 }));
  const report = { unit: { used: "mm", source: "assumed" }, unit_candidates: { ranked, likely: "in" }, before: { print: { size_mm: [1, 1, 1] } } };
  const choices = unitChoices(report as unknown as Parameters<typeof unitChoices>[0]);
  assert.deepEqual(choices.map(({ unit, wall }) => [unit, wall]), [["in", 2], ["m", 2], ["mm", null]]);
  assert.deepEqual(choices[2]!.size, [1, 1, 1]);
});

test("bands of wall thickness are multiples of the least wall", () => {
  assert.deepEqual(bandOf("thickness_0", 0.8), { from: null, to: 0.2 });
  assert.deepEqual(bandOf("thickness_3", 0.8), { from: 0.6000000000000001, to: 0.8 });
  assert.deepEqual(bandOf(THICK_BAND, 0.8), { from: 3.2, to: null });
  assert.equal(bandOf("hole", 0.8), null);
  assert.equal(leastWallOf({ options: { min_wall: 1.5 }, report: null } as unknown as Job), 1.5);
  assert.equal(leastWallOf({ options: {}, report: null } as unknown as Job), null);
});

test("each file of an analysis has its own rules", () => {
  const ready = { process: "tpu", title: "TPU", ready: true, rules: [] };
  const report = { mode: "analyze", files: [{ name: "a.stl", print_ready: ready }, { name: "b.stl" }] } as unknown as Job["report"];
  assert.deepEqual(readinessOfFiles(report), [{ name: "a.stl", readiness: ready }]);
  assert.deepEqual(readinessOfFiles(null), []);
});
