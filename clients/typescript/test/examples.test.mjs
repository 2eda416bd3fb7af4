import assert from "node:assert/strict";
import { spawn } from "node:child_process";
import { mkdtempSync, readFileSync, rmSync, writeFileSync } from "node:fs";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { after, before, test } from "node:test";
import { Client } from "meshmend-client";
import { brokenRing, soundBox } from "../../../tests/browser/support/models.mjs";
import { serve } from "../../../tests/browser/support/service.mjs";

let service, folder;
before(async () => {
  service = await serve("--webhook-allow-private");
  folder = mkdtempSync(join(tmpdir(), "meshmend-examples-"));
  writeFileSync(join(folder, "ring.stl"), brokenRing());
  writeFileSync(join(folder, "box.stl"), soundBox());
  writeFileSync(join(folder, "notes.txt"), "no model at all");
});
after(async () => {
  await service.stop();
  rmSync(folder, { recursive: true, force: true });
});

function start(name, args, env = {}) {
  const script = new URL(`../examples/${name}.mjs`, import.meta.url).pathname;
  return spawn(process.execPath, [script, ...args], { cwd: folder, env: { ...process.env, ...env } });
}

async function example(name, ...args) {
  const child = start(name, args);
  let [out, err] = ["", ""];
  child.stdout.on("data", (bytes) => (out += bytes));
  child.stderr.on("data", (bytes) => (err += bytes));
  const code = await new Promise((resolve) => child.once("close", resolve));
  return { code, out, err };
}

test("the examples repair, analyse, and report progress and errors", async () => {
  const plain = await example("repair", service.url, "ring.stl", "plain.stl");
  assert.equal(plain.code, 0, plain.err);
  assert.match(plain.out, /^repaired: .{10,}/);
  const careful = await example("careful", service.url, "ring.stl", "careful.stl");
  assert.deepEqual([careful.code, careful.out], [0, "repaired\n"], careful.err);
  assert.match(careful.err, /\d %/);
  assert.deepEqual(readFileSync(join(folder, "plain.stl")), readFileSync(join(folder, "careful.stl")));
  const refused = await example("careful", service.url, "notes.txt", "none.stl");
  assert.equal(refused.code, 1);
  assert.match(refused.err, /^refused: unsupported_model: .+ \(request .+\)/);
  const analysis = await example("analyze", service.url, "box.stl", "ring.stl");
  assert.match(analysis.out, /^box.stl: printable\nring.stl: not printable \d+ \w+/);
});

test("a webhook is verified, and a forged one is rejected", async () => {
  const client = new Client(service.url);
  const { secret } = await client.webhooks.secret();
  const child = start("webhook", ["0"], { WEBHOOK_SECRET: secret });
  const lines = child.stdout.setEncoding("utf8")[Symbol.asyncIterator]();
  const port = /\d+/.exec((await lines.next()).value)[0];
  const callbackUrl = `http://127.0.0.1:${port}/`;
  const forged = await fetch(callbackUrl, { method: "POST", body: "{}", headers: { "webhook-id": "msg_1", "webhook-timestamp": "1", "webhook-signature": "v1,bm8=" } });
  assert.equal(forged.status, 400);
  const job = await client.repair(soundBox(), { pictures: false }, { callbackUrl });
  assert.equal((await lines.next()).value, `job.succeeded ${job.id} already_printable\n`);
  const ended = new Promise((resolve) => child.once("close", resolve));
  child.kill();
  await ended;
});
