import assert from "node:assert/strict";
import { test } from "node:test";
import type { Job } from "meshmend-client";
import { isUnfinished, suggestions } from "../src/report/advice";
import { claimsOf } from "../src/report/verdict";

const ALL = ["closed", "manifold", "outward", "no_intersections"];

function job(outcome: string | null, verdict: object, more: object = {}): Job {
  const report = { mode: "repair", outcome, verdict, before: { closed: true }, red_flags: [], assumptions: [], warnings: [] };
  return { status: "succeeded", outcome, report, artifacts: {}, options: {}, problem: null, ...more } as unknown as Job;
}

test("claims properties only of a printable file", () => {
  const good = claimsOf(job("repaired", { printable: true, passes: true, file: "model", proven: ALL }));
  assert.deepEqual([good.tone, good.title, good.isPrintable, good.proven], ["good", "repaired", true, ALL]);
  const flagged = claimsOf(job("partially_repaired", { printable: false, passes: true, file: "model", proven: ALL }));
  assert.deepEqual([flagged.tone, flagged.title, flagged.isPrintable, flagged.proven], ["fair", "flagged", false, []]);
  const broken = claimsOf(job("partially_repaired", { printable: false, passes: false, file: "model", proven: ["closed"] }));
  assert.deepEqual([broken.tone, broken.title, broken.proven], ["fair", "partially_repaired", []]);
  const some = claimsOf(job("repaired", { printable: true, passes: false, file: "model", proven: ["closed"] }));
  assert.deepEqual(some.proven, ["closed"], "no more than was proven");
});

test("claims nothing from a report without a verdict", () => {
  const old = claimsOf({ ...job("repaired", {}), report: { mode: "repair", outcome: "repaired" } } as unknown as Job);
  assert.deepEqual([old.isPrintable, old.proven], [true, []]);
});

test("an unrepairable job offers the upload, not a model", () => {
  const original = { href: "/v1/jobs/job_1/artifacts/original" };
  const claims = claimsOf(job("unrepairable", { printable: false, passes: false, file: "original", proven: [] }, { artifacts: { original } }));
  assert.deepEqual([claims.tone, claims.model, claims.original], ["fair", null, original]);
});

test("a job that failed as not printable says so and suggests a remedy", () => {
  const verdict = { printable: false, passes: false, file: "none", proven: [] };
  const refused = job("partially_repaired", verdict, { status: "failed", outcome: null, problem: { code: "not_printable" } });
  const claims = claimsOf(refused);
  assert.deepEqual([claims.tone, claims.title, claims.isRefused, claims.isPrintable], ["bad", "not_printable", true, false]);
  assert.ok(isUnfinished(refused));
  const can = { tiers: [{ tier: 3, available: true }] } as unknown as Parameters<typeof suggestions>[1];
  assert.deepEqual(suggestions(refused, can).map(({ name }) => name), ["tryRemesh"]);
  const crashed = job(null, verdict, { status: "failed", report: null, problem: { code: "crashed" } });
  assert.deepEqual([claimsOf(crashed).title, suggestions(crashed, can).map(({ name }) => name)], ["failed", ["tryAgain"]]);
});
