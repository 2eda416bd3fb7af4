import assert from "node:assert/strict";
import { test } from "node:test";
import type { Job, RuleResult } from "meshmend-client";
import { isUnfinished, suggestions } from "../src/report/advice";
import { mendingOptions, readinessOf, ruleValue, sortedRules, withProcess } from "../src/report/print-ready";
import { claimsOf } from "../src/report/verdict";
import { Figures } from "../src/units";

function rule(rule: string, result: string, more: object = {}): RuleResult {
  return { rule, result, count: 0, ...more } as unknown as RuleResult;
}

function job(rules: RuleResult[], options: object = {}, more: object = {}): Job {
  const print_ready = { process: "fdm-0.4", title: "FDM", ready: false, rules };
  const report = { mode: "repair", outcome: "repaired", verdict: { printable: true, proven: [] }, before: { closed: true }, print_ready };
  return { status: "succeeded", outcome: "repaired", report, artifacts: {}, options, problem: null, ...more } as unknown as Job;
}

test("broken rules come first, and rules that were met last", () => {
  const rules = [rule("solid", "pass"), rule("gap", "undecided"), rule("free_wall", "fail"), rule("pin", "fail")];
  const readiness = readinessOf(job(rules));
  assert.deepEqual(sortedRules(readiness!).map(({ rule }) => rule), ["free_wall", "pin", "gap", "solid"]);
  assert.equal(readinessOf({ report: null } as unknown as Job), null);
  const analysis = (files: object[]): Job => ({ report: { mode: "analyze", files } }) as unknown as Job;
  assert.equal(readinessOf(analysis([{ print_ready: readiness }])), readiness);
  assert.equal(readinessOf(analysis([{}, {}])), null);
});

test("values of rules have the unit of their rule", () => {
  const figures = new Figures("en");
  assert.equal(ruleValue("free_wall", 0.8, figures), "0.8 mm");
  assert.equal(ruleValue("part_volume", 27, figures), "27 mm³");
  assert.equal(ruleValue("face_count", 1_000_000, figures), "1,000,000");
  assert.equal(ruleValue("file_size", 64_000_000, figures), "64 MB");
  assert.equal(ruleValue("solid", null, figures), "–");
});

test("a broken rule offers the options that mend it and keeps the others", () => {
  const it = job([], { process: "fdm-0.4", max_tier: 2 });
  const mended = (name: string, limit?: number): object | null => mendingOptions(it, rule(name, "fail", { limit }));
  assert.deepEqual(mended("free_wall", 1), { process: "fdm-0.4", max_tier: 2, min_wall: 1 });
  assert.deepEqual(mended("escape_holes", 4), { process: "fdm-0.4", max_tier: 2, voids: "vent" });
  assert.deepEqual(mended("part_volume", 27), { process: "fdm-0.4", max_tier: 2, islands: "drop" });
  assert.equal(mended("clearance", 0.5), null);
  assert.equal(mendingOptions(it, rule("free_wall", "pass", { limit: 1 })), null);
  const maySet = (option: string): boolean => option !== "voids";
  assert.equal(mendingOptions(it, rule("escape_holes", "fail"), maySet), null, "a shop may keep an option to itself");
  assert.notEqual(mendingOptions(it, rule("part_volume", "fail"), maySet), null);
});

test("another process replaces the limits of the process before", () => {
  const before = { process: "small", process_limits: { based_on: "sls-pa12" }, require: "print_ready", max_tier: 2 };
  assert.deepEqual(withProcess(before, "tpu"), { process: "tpu", require: "print_ready", max_tier: 2 });
  assert.deepEqual(withProcess(before, ""), { require: "printable", max_tier: 2 });
});

test("a job that failed as not print ready says so and suggests no other repair", () => {
  const refused = job([rule("free_wall", "fail")], {}, { status: "failed", problem: { code: "not_print_ready" } });
  const claims = claimsOf(refused);
  assert.deepEqual([claims.tone, claims.title, claims.isRefused], ["bad", "not_print_ready", true]);
  const can = { tiers: [{ tier: 3, available: true }] } as unknown as Parameters<typeof suggestions>[1];
  assert.equal(isUnfinished(refused), false);
  assert.deepEqual(suggestions(refused, can), []);
});
