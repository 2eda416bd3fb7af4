// The page from a dropped model to the repaired one.
import assert from "node:assert/strict";
import { createHash } from "node:crypto";
import { readFileSync } from "node:fs";
import { test } from "node:test";
import { LOOKS, drop, open, pixels, settled, shown } from "./support/browser.mjs";
import { browser, service } from "./support/service-and-browser.mjs";
import { brokenRing, largeRing, sheet, soundBox, thinWall, twoObjects } from "./support/models.mjs";

const sha256 = (bytes) => createHash("sha256").update(bytes).digest("hex");

/** The bytes that a click makes the browser save, and their name. */
async function saved(page, click) {
  const [download] = await Promise.all([page.waitForEvent("download"), click()]);
  return { name: download.suggestedFilename(), bytes: readFileSync(await download.path()) };
}

async function jobs() {
  return (await (await fetch(`${service.url}/v1/jobs`)).json()).jobs;
}

test("the list shows the stages of a repair in their order", { timeout: 120_000 }, async () => {
  const { page, faults, close } = await open(browser, service.url);
  await page.getByRole("heading", { name: "Drop a 3D model" }).waitFor();
  await page.evaluate(() => {
    const seen = (window.stages = []);
    new MutationObserver(() => {
      const now = document.querySelector(".stages li.now span:nth-child(2)")?.textContent;
      if (now && seen.at(-1) !== now) seen.push(now);
    }).observe(document.body, { subtree: true, childList: true, characterData: true, attributes: true });
  });
  // Small enough to be quick, and large enough that a stage lasts longer than an event takes to arrive.
  await drop(page, [["large.stl", largeRing(60_000)]]);
  await page.getByRole("heading", { name: "Repaired and printable" }).waitFor({ timeout: 60_000 });
  const stages = await page.evaluate(() => window.stages);
  const order = ["Upload", "Queue", "Read the file", "Look for defects", "Repair", "Check the result", "Draw pictures and save"];
  assert.ok(stages.length >= 3 && stages[0] === "Upload", `stages seen: ${stages}`);
  assert.deepEqual(stages, order.filter((stage) => stages.includes(stage)), "they come in their order");
  assert.deepEqual(faults, []);
  await close();
});

test("a dropped model is repaired, shown and downloaded as the API has it", { timeout: 120_000 }, async () => {
  const { page, faults, asked, close } = await open(browser, service.url);
  await page.getByRole("heading", { name: "Drop a 3D model" }).waitFor();
  await page.getByText("STL, OBJ, PLY").waitFor();
  await drop(page, [["ring.stl", brokenRing()]]);
  await shown(page);
  await page.getByRole("heading", { name: "Repaired and printable" }).waitFor();
  for (const line of ["2 holes closed", "2 parts united"]) await page.getByText(line, { exact: true }).waitFor();

  // Before on the left with coloured defects, after on the right without.
  const [left, right] = [await pixels(page, LOOKS, [0, 0.49]), await pixels(page, LOOKS, [0.51, 1])];
  assert.ok(left.grey > 10_000 && right.grey > 10_000, JSON.stringify({ left, right }));
  assert.ok(left.orange > 100 && left.red > 1000, JSON.stringify(left));
  assert.ok(right.orange === 0 && right.red < 50 && right.blue > 100, JSON.stringify(right));

  // A layer that is switched off is not visible.
  const holes = page.getByRole("button", { name: /\d+ holes?$/ }).first();
  assert.equal(await holes.getAttribute("aria-pressed"), "true");
  await holes.click();
  await settled(page);
  assert.equal((await pixels(page, LOOKS, [0, 0.49])).orange, 0);
  await holes.click();
  await settled(page);
  assert.ok((await pixels(page, LOOKS, [0, 0.49])).orange > 100);

  const job = (await jobs()).find((other) => other.input.name === "ring.stl");
  const model = await saved(page, () => page.getByRole("button", { name: "Download STL" }).click());
  const served = Buffer.from(await (await fetch(`${service.url}${job.artifacts.model.href}`)).arrayBuffer());
  assert.equal(model.name, "ring-repaired.stl");
  assert.ok(model.bytes.equals(served), "the bytes are the API's");
  assert.equal(sha256(model.bytes), job.artifacts.model.sha256);

  // The result is converted to another format.
  const off = await saved(page, () => page.getByLabel("Other format").selectOption("off"));
  assert.equal(off.name, "ring-repaired.off");
  assert.match(off.bytes.subarray(0, 20).toString(), /^OFF/);

  assert.deepEqual(faults, []);
  assert.ok(asked.every((url) => url.startsWith(service.url) || url.startsWith("blob:")), `asked elsewhere: ${asked}`);
  await close();
});

test("the camera goes to a place, and all tools of the viewer work", { timeout: 120_000 }, async () => {
  const { page, faults, close } = await open(browser, service.url, { reducedMotion: "reduce" });
  await drop(page, [["ring.stl", brokenRing()]]);
  await shown(page);
  const before = await pixels(page, LOOKS, [0, 0.49]);
  await page.getByRole("button", { name: "Show in the viewer: holes" }).click();
  await page.getByText("1 of 2").waitFor();
  await settled(page);
  const near = await pixels(page, LOOKS, [0, 0.49]);
  assert.ok(near.orange > 1.5 * before.orange && near.red === 0, `the hole is seen from near: ${JSON.stringify({ before, near })}`);
  await page.getByRole("button", { name: "Show all" }).click();

  await page.getByRole("button", { name: "Slider" }).click();
  const handle = page.getByRole("slider", { name: "Divider between before and after" });
  await handle.press("End");
  await settled(page);
  const all = await pixels(page, LOOKS);
  await handle.press("Home");
  await settled(page);
  const none = await pixels(page, LOOKS);
  assert.ok(all.red > 1000 && none.red < 50, JSON.stringify({ all, none }));

  await page.getByRole("button", { name: "After", exact: true }).click();
  await page.getByRole("button", { name: "Dimensions" }).click();
  await page.getByText("80 mm", { exact: true }).first().waitFor();
  await page.getByLabel("Unit", { exact: true }).selectOption("in");
  await page.getByText("3.15 in", { exact: true }).first().waitFor();
  await page.getByLabel("Unit", { exact: true }).selectOption("mm");

  await settled(page);
  const whole = await pixels(page, LOOKS);
  await page.getByLabel("Cross-section", { exact: true }).selectOption("y");
  await settled(page);
  const cut = await pixels(page, LOOKS);
  assert.ok(cut.grey < 0.8 * whole.grey, JSON.stringify({ whole, cut }));
  await page.getByLabel("Cross-section", { exact: true }).selectOption("");
  await page.getByRole("button", { name: "Wireframe" }).click();
  await settled(page);
  assert.ok((await pixels(page, LOOKS)).grey < 0.95 * whole.grey, "wires are darker");

  await page.getByLabel("Printer").selectOption({ label: "Prusa MINI+ · 180 × 180 × 180" });
  await page.getByText("The model fits.").waitFor();
  await page.getByLabel("Printer").selectOption("own");
  await page.getByRole("spinbutton", { name: "X" }).fill("50");
  await page.getByText("The model fits if you turn it.").waitFor();
  await page.getByRole("spinbutton", { name: "Y" }).fill("50");
  await page.getByText("The model does not fit.").waitFor();
  assert.deepEqual(faults, []);
  await close();
});

test("a canvas is turned and zoomed by keys", { timeout: 60_000 }, async () => {
  const { page, faults, close } = await open(browser, service.url);
  await drop(page, [["box.stl", soundBox()]]);
  await shown(page);
  await page.getByRole("heading", { name: "Already printable" }).waitFor();
  const canvas = page.locator("canvas");
  const first = await canvas.screenshot();
  await canvas.press("ArrowLeft");
  await settled(page);
  const turned = await canvas.screenshot();
  assert.ok(!turned.equals(first), "an arrow turns it");
  const grey = (await pixels(page, LOOKS)).grey;
  await canvas.press("+");
  await canvas.press("+");
  await settled(page);
  assert.ok((await pixels(page, LOOKS)).grey > 1.2 * grey, "plus brings it nearer");
  assert.deepEqual(faults, []);
  await close();
});

test("walls thinner than a printer makes are marked", { timeout: 60_000 }, async () => {
  const { page, faults, close } = await open(browser, service.url);
  await drop(page, [["wall.stl", thinWall()]]);
  await shown(page);
  const layer = page.locator(".layer.thin");
  // More places than the first ones, which are in the job itself.
  await layer.getByText(/^\d{2,}$/).waitFor();
  await settled(page);
  assert.match(await layer.textContent(), /places with thin walls/);
  assert.ok((await pixels(page, LOOKS)).pink > 100);
  await page.getByLabel("Walls thinner than").selectOption("0.4");
  await settled(page);
  assert.match(await layer.textContent(), /^0places/);
  assert.equal((await pixels(page, LOOKS)).pink, 0);
  assert.deepEqual(faults, []);
  await close();
});

test("for an unrepaired model the page suggests a remedy, and a click applies it", { timeout: 120_000 }, async () => {
  const { page, faults, close } = await open(browser, service.url);
  await drop(page, [["sheet.obj", sheet()]]);
  await shown(page);
  await page.getByRole("heading", { name: "Not repairable" }).waitFor();
  await page.getByText("Still there: 1 hole.").waitFor();
  assert.equal(await page.getByRole("button", { name: /^Download/ }).count(), 0, "there is no model");
  const upload = await saved(page, () => page.getByRole("button", { name: "Your original file" }).click());
  assert.deepEqual([upload.name, upload.bytes.equals(Buffer.from(sheet()))], ["sheet.obj", true]);
  assert.ok((await pixels(page, LOOKS, [0.51, 1])).orange > 100, "what remains is shown on the result");
  await page.getByRole("button", { name: "Make it 1.2 mm thick" }).click();
  await page.getByRole("heading", { name: "Repaired and printable" }).waitFor({ timeout: 60_000 });
  assert.deepEqual(faults, []);
  await close();
});

test("many files are dropped at once, and an invalid one is reported and stops no other", { timeout: 120_000 }, async () => {
  const { page, faults, close } = await open(browser, service.url);
  const cut = Buffer.from("solid cut\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\n");
  await drop(page, [["a.stl", soundBox()], ["cut.stl", cut], ["notes.txt", Buffer.from("hello")], ["b.stl", thinWall()]]);
  await page.locator(".file.good").nth(1).waitFor({ timeout: 60_000 });
  await page.locator(".file.bad").nth(1).waitFor({ timeout: 60_000 });
  await page.getByRole("button", { name: /cut\.stl.*failed/ }).click();
  await page.getByText("export it again, preferably as binary STL").waitFor();
  await page.getByText("Code: bad_input").waitFor();
  await page.getByRole("button", { name: /^notes\.txt/ }).click();
  await page.getByText(/Code: unsupported_model/).waitFor();
  assert.deepEqual(faults.filter((fault) => !/status of 415/.test(fault)), []);
  await close();
});

test("an upload is paused, restarted and resumed", { timeout: 120_000 }, async () => {
  const { page, faults, close } = await open(browser, service.url);
  const session = await page.context().newCDPSession(page);
  await session.send("Network.enable");
  await session.send("Network.emulateNetworkConditions", { offline: false, latency: 0, downloadThroughput: -1, uploadThroughput: 60_000 });
  await drop(page, [["ring.stl", brokenRing()]]);
  await page.getByRole("button", { name: "Pause: ring.stl" }).click();
  await page.getByText("Paused").waitFor();
  assert.ok(!(await jobs()).some((job) => job.input.name === "ring.stl" && job.status !== "succeeded"), "nothing was submitted");
  await session.send("Network.emulateNetworkConditions", { offline: false, latency: 0, downloadThroughput: -1, uploadThroughput: -1 });
  await page.getByRole("button", { name: "Continue: ring.stl" }).click();
  await shown(page);
  assert.deepEqual(faults, []);
  await close();
});

test("the sample repairs itself to something printable", { timeout: 60_000 }, async () => {
  const { page, faults, close } = await open(browser, service.url);
  await page.getByRole("button", { name: "Try a broken sample" }).click();
  await page.getByRole("heading", { name: "Repaired and printable" }).waitFor({ timeout: 60_000 });
  await page.getByText("3 holes closed", { exact: true }).waitFor();
  assert.deepEqual(faults, []);
  await close();
});

test("the objects of a file are listed one by one", { timeout: 60_000 }, async () => {
  const { page, faults, close } = await open(browser, service.url);
  await drop(page, [["pair.gltf", twoObjects()]]);
  await shown(page);
  await page.getByText("The 2 objects of this file").waitFor();
  const whole = page.getByRole("row", { name: /whole/ });
  await whole.getByText("Already printable").waitFor();
  const lidless = page.getByRole("row", { name: /no lid/ });
  await lidless.getByText("Repaired and printable").waitFor();
  await lidless.getByText("1 hole closed").waitFor();
  await lidless.getByText("10 → 12").waitFor();
  assert.deepEqual(faults, []);
  await close();
});
