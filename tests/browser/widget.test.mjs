// The widget on the page of a shop: the demo shop of examples/shop, on another origin than the service.
import assert from "node:assert/strict";
import { createHash } from "node:crypto";
import { readFileSync, readdirSync } from "node:fs";
import { createServer } from "node:http";
import { join } from "node:path";
import { test } from "node:test";
import { LOOKS, PAINTS, drop, open, pixels, settled, shown } from "./support/browser.mjs";
import { colouredGlb } from "./support/coloured.mjs";
import { brokenRing, hollowBox, plate, sheet, soundBox, thinWall } from "./support/models.mjs";
import { run } from "./support/service.mjs";
import { BOX, CUT, browser, eventDetails, jobOf, setOptions, shop, visit, widget } from "./support/shop-and-browser.mjs";

/** A token of meshmend for pages of an origin, as a shop's backend requests it. */
async function tokenFor(origin) {
  const init = { method: "POST", headers: { "content-type": "application/json" }, body: JSON.stringify({ origin }) };
  return (await shop.ask("/v1/browser-tokens", init)).json();
}

test("a customer uploads, sees the result and orders it, and the shop has the model", { timeout: 120_000 }, async () => {
  const { page, faults, asked, close } = await visit();
  assert.ok(!asked.some((url) => url.includes("/assets/")), "the viewer comes when there is something to see");
  await drop(page, [["ring.stl", brokenRing()]], BOX);
  await shown(page);
  await page.getByRole("heading", { name: "Repaired and printable" }).waitFor();
  await page.getByText("2 holes closed", { exact: true }).waitFor();
  const seen = await pixels(page, LOOKS);
  assert.ok(seen.grey > 5000 && seen.orange > 100, `both models are seen: ${JSON.stringify(seen)}`);
  const [{ jobId }] = await eventDetails(page, "uploaded");
  const job = await jobOf(jobId);
  await page.getByText(/cm³ cost €\d/).waitFor();
  const price = 390 + 0.038 * job.report.after.print.volume + 0.02 * job.report.after.print.area;
  await page.getByText(`€${(Math.ceil(price) / 100).toFixed(2)}`).waitFor();
  await page.getByRole("button", { name: "Order" }).click();
  await page.getByText("Your order is in production").waitFor();
  const [folder] = readdirSync(shop.folder);
  const [file] = readdirSync(join(shop.folder, folder));
  assert.equal(file, "ring-repaired.stl");
  const bytes = readFileSync(join(shop.folder, folder, file));
  assert.equal(createHash("sha256").update(bytes).digest("hex"), job.artifacts.model.sha256);
  assert.deepEqual(faults, []);
  await close();
});

test("a customer takes another result, and the shop prices and fetches that one", { timeout: 120_000 }, async () => {
  const { page, faults, close } = await visit();
  await setOptions(page, { alternatives: true });
  await drop(page, [["hollow.stl", hollowBox()]], BOX);
  await page.getByText(/^22\.0 cm³ cost/).waitFor();
  await page.locator(".choice").nth(1).getByRole("radio").check();
  await page.locator("[part=facts]", { hasText: "24 cm³" }).waitFor();
  await page.getByText(/^24\.0 cm³ cost[\s\S]*Assumed: Sealed cavities/).waitFor();
  await page.getByRole("button", { name: "Order" }).click();
  await page.getByText("Your order is in production").waitFor();
  const orders = readdirSync(shop.folder).flatMap((folder) => readdirSync(join(shop.folder, folder)).map((file) => join(shop.folder, folder, file)));
  const ordered = orders.find((file) => file.includes("hollow"));
  assert.equal(readFileSync(ordered).readUInt32LE(80), 12, "the faces of the box without its cavity");
  assert.deepEqual(faults, []);
  await close();
});

test("a customer reads the rules of the process without scrolling sideways", { timeout: 120_000 }, async () => {
  for (const width of [1200, 700, 360]) {
    const { page, close } = await visit({ viewport: { width, height: 900 } });
    await setOptions(page, { unit: "mm", process: "fdm-0.4" });
    await drop(page, [["plate.stl", plate()]], BOX);
    const rule = page.locator("table.rules tr", { hasText: "Volume of each solid" });
    await rule.waitFor();
    assert.match(await rule.innerText(), /broken[\s\S]*27 mm³[\s\S]*7\.2 mm³[\s\S]*Remove the small solids/);
    const hidden = (element) => element.scrollWidth - element.clientWidth;
    assert.deepEqual(await Promise.all([".told", ".print-ready .table"].map((part) => page.locator(part).evaluate(hidden))), [0, 0], `${width} px`);
    await close();
  }
});

test("a customer thickens a wall that breaks a rule of the shop's process, unless the shop sets the thickness", { timeout: 120_000 }, async () => {
  for (const [options, remedies] of [[{}, 1], [{ min_wall: 0.4 }, 0]]) {
    const { page, faults, close } = await visit();
    await setOptions(page, { unit: "mm", process: "fdm-0.4", ...options });
    await drop(page, [["wall.stl", thinWall()]], BOX);
    const rule = page.locator("table.rules tr.fail", { hasText: "Free walls" });
    await rule.waitFor();
    const remedy = rule.getByRole("button", { name: "Run again with this remedy" });
    assert.equal(await remedy.count(), remedies);
    if (remedies > 0) {
      await remedy.click();
      await page.getByText("The model meets every rule of FDM").waitFor();
      assert.deepEqual((await eventDetails(page, "repaired")).map(({ metrics }) => metrics.printReady), [false, true]);
    }
    assert.deepEqual(faults, []);
    await close();
  }
});

test("a refusal is explained to the customer, and its detail goes to the shop", { timeout: 120_000 }, async () => {
  const { page, faults, close } = await visit();
  await setOptions(page, { unit: "mm", process: "fdm-0.4", require: "print_ready" });
  await drop(page, [["wall.stl", thinWall()]], BOX);
  await page.locator(".problem .what", { hasText: "The model breaks rules of the printing process. The table lists them." }).waitFor();
  await page.locator("table.rules tr.fail", { hasText: "Free walls" }).waitFor();
  assert.equal(await page.locator(".problem .detail").count(), 0);
  const [failed] = await eventDetails(page, "failed");
  assert.equal(failed.code, "not_print_ready");
  assert.notEqual(failed.detail, "");
  assert.deepEqual(faults, []);
  await close();
});

test("the numbers of the events are those of the job's report", { timeout: 120_000 }, async () => {
  const { page, faults, close } = await visit();
  await widget(page).evaluate((element) => element.setAttribute("unit", "in"));
  await drop(page, [["box.stl", soundBox()]], BOX);
  const [repaired] = await eventDetails(page, "repaired");
  const job = await jobOf(repaired.jobId);
  const { print, bounding_box } = job.report.after ?? job.report.before;
  assert.deepEqual([repaired.status, repaired.outcome], [job.status, job.outcome]);
  const { metrics } = repaired;
  assert.deepEqual([metrics.printable, metrics.unit, metrics.unitSource, metrics.solids], [true, "in", "declared", print.solids]);
  assert.deepEqual(metrics.sizeMm, print.size_mm);
  assert.deepEqual(metrics.boxMm.max, bounding_box.max.map((x) => x * 25.4));
  const near = (a, b) => assert.ok(Math.abs(a - b) < 1e-9 * Math.abs(b), `${a} is not ${b}`);
  near(metrics.volumeMm3, print.volume * 25.4 ** 3);
  near(metrics.volumeMm3, 24_000 * 25.4 ** 3);
  near(metrics.areaMm2, print.area * 25.4 ** 2);
  near(metrics.thinnestWallMm, print.thinnest_wall.thickness * 25.4);
  const [first] = await eventDetails(page, "progress");
  assert.deepEqual([first.status, first.jobId, first.bytes], ["uploading", null, soundBox().length]);
  const shares = (await eventDetails(page, "progress")).filter(({ status }) => status !== "uploading");
  assert.ok(shares.length > 0 && shares.every(({ jobId }) => jobId === repaired.jobId));
  // The shop does not print models that large.
  assert.deepEqual(faults.filter((fault) => !/status of 422/.test(fault)), []);
  await close();
});

test("the shop's page has the documented policy, and nothing violates it", { timeout: 60_000 }, async () => {
  const documented = /```http\nContent-Security-Policy: ([^`]+)\n```/.exec(readFileSync(new URL("../../docs/widget.md", import.meta.url), "utf8"))[1];
  const sent = (await fetch(shop.url)).headers.get("content-security-policy");
  assert.equal(sent, documented.replaceAll("https://meshmend.example", shop.meshmend).replaceAll(/\s+/g, " "));
  assert.ok(!/unsafe|\*|blob:|data:/.test(sent), sent);
});

test("an unreadable model fails with the problem's code and detail", { timeout: 60_000 }, async () => {
  const { page, faults, close } = await visit();
  await drop(page, [["cut.stl", CUT]], BOX);
  const [failed] = await eventDetails(page, "failed");
  assert.deepEqual([failed.status, failed.code], ["failed", "bad_input"]);
  assert.equal(failed.message, "The file is not readable. Please export it again, preferably as binary STL.");
  assert.equal(failed.detail, (await jobOf(failed.jobId)).problem.detail);
  await widget(page).getByText(failed.message).waitFor();
  assert.equal(await page.locator("#offer").textContent(), failed.message);
  await page.getByRole("button", { name: "Upload another model" }).click();
  await drop(page, [["notes.txt", Buffer.from("hello")]], BOX);
  await widget(page).getByText("This file is not a readable 3D model").waitFor();
  assert.equal((await eventDetails(page, "failed"))[1].code, "unsupported_model");
  assert.deepEqual(faults.filter((fault) => !/status of 415/.test(fault)), []);
  await close();
});

test("for an unrepaired model the widget suggests a remedy, and a click applies it", { timeout: 120_000 }, async () => {
  const { page, faults, close } = await visit();
  await drop(page, [["sheet.obj", sheet()]], BOX);
  const [failed] = await eventDetails(page, "failed");
  assert.deepEqual([failed.status, failed.outcome, failed.code], ["succeeded", "unrepairable", "unrepairable"]);
  assert.equal(await page.getByRole("button", { name: "Order" }).isDisabled(), true);
  await page.getByRole("button", { name: "2 mm", exact: true }).click();
  await page.getByRole("button", { name: "Make it 2 mm thick" }).click();
  const [repaired] = await eventDetails(page, "repaired");
  assert.equal(repaired.outcome, "repaired");
  const { options } = await jobOf(repaired.jobId);
  assert.deepEqual([options.open_sheets, options.thickness], ["thicken", 2]);
  await page.getByText("This open surface was given a thickness of 2 mm.").waitFor();
  // The shop does not print models that thin.
  assert.deepEqual(faults.filter((fault) => !/status of 422/.test(fault)), []);
  await close();
});

test("a customer reads the size first, and all of it fits into the widget", { timeout: 120_000 }, async () => {
  for (const viewport of [{ width: 1360, height: 900 }, { width: 360, height: 740 }]) {
    const { page, faults, close } = await visit({ viewport });
    await drop(page, [["ring.stl", brokenRing()]], BOX);
    await shown(page);
    const [facts, room] = await page.evaluate(() => {
      const { shadowRoot } = document.querySelector("meshmend-upload");
      return [".facts", ".told"].map((part) => shadowRoot.querySelector(part).getBoundingClientRect().toJSON());
    });
    assert.ok(facts.top >= room.top && facts.bottom <= room.bottom && facts.left >= room.left && facts.right <= room.right, JSON.stringify({ viewport, facts, room }));
    for (const text of ["80 × 80 × 26 mm", "60.73 cm³"]) await widget(page).getByText(text, { exact: true }).waitFor();
    assert.deepEqual(faults, []);
    await close();
  }
});

test("a customer sets the unit and the size, unless the shop does", { timeout: 120_000 }, async () => {
  const { page, faults, asked, close } = await visit();
  await drop(page, [["box.stl", soundBox()]], BOX);
  await eventDetails(page, "repaired");
  await widget(page).getByText("The file states no unit. Its lengths were read as mm.").waitFor();
  await widget(page).getByText("Unit and size").first().click();
  await widget(page).getByLabel("Unit of the file").selectOption("cm");
  await page.getByRole("button", { name: "Run again with these settings" }).click();
  await page.waitForFunction(() => events.filter(([name]) => name === "repaired").length === 2, null, { timeout: 60_000 });
  const metrics = (await eventDetails(page, "repaired"))[1].metrics;
  assert.deepEqual([metrics.sizeMm, metrics.unitSource], [[400, 300, 200], "declared"]);
  assert.equal(asked.filter((url) => /\/v1\/uploads$/.test(url)).length, 1, "the service still has the file");
  await widget(page).getByText("Unit and size").first().click();
  await widget(page).getByLabel("Longest side in mm").fill("50");
  await page.getByRole("button", { name: "Run again with these settings" }).click();
  await page.waitForFunction(() => events.filter(([name]) => name === "repaired").length === 3, null, { timeout: 60_000 });
  const [length, width, height] = (await eventDetails(page, "repaired"))[2].metrics.sizeMm;
  assert.ok(Math.abs(length - 50) < 1e-4 && Math.abs(width - 37.5) < 1e-4 && Math.abs(height - 25) < 1e-4, `${[length, width, height]}`);
  await page.getByRole("button", { name: "Upload another model" }).click();
  await widget(page).evaluate((element) => (element.setAttribute("unit", "mm"), element.setAttribute("options", JSON.stringify({ open_sheets: "thicken", thickness: 1 }))));
  await drop(page, [["sheet.obj", sheet()]], BOX);
  await page.getByRole("heading", { name: "Repaired and printable" }).waitFor({ timeout: 60_000 });
  await widget(page).getByText("1 open surface was given a thickness of 1 mm.").waitFor();
  assert.equal(await widget(page).getByText("Unit and size").count(), 0);
  assert.equal(await widget(page).getByText("Thickness of the open surface").count(), 0);
  // The shop does not print models that large or that thin.
  assert.deepEqual(faults.filter((fault) => !/status of 422/.test(fault)), []);
  await close();
});

test("a model is shown in its own colours", { timeout: 120_000 }, async () => {
  const { page, faults, close } = await visit();
  await drop(page, [["boxes.glb", colouredGlb()]], BOX);
  await page.locator("canvas[data-coloured]").waitFor({ timeout: 60_000 });
  await settled(page);
  const seen = await pixels(page, PAINTS);
  assert.ok(seen.red > 2000 && seen.yellow > 2000 && seen.blue > 2000, JSON.stringify(seen));
  assert.deepEqual(faults.filter((fault) => !/status of 422/.test(fault)), []);
  await close();
});

test("a token for another origin is refused, and the widget says so", { timeout: 60_000 }, async () => {
  const { page, faults, close } = await visit({ url: `http://localhost:${shop.port}` });
  const { token } = await tokenFor(shop.url);
  await widget(page).evaluate((element, token) => element.setAttribute("token", token), token);
  await drop(page, [["box.stl", soundBox()]], BOX);
  await widget(page).getByText("not valid for the address of this page").waitFor();
  const [failed] = await eventDetails(page, "failed");
  assert.deepEqual([failed.status, failed.jobId, failed.code], ["refused", null, "origin_not_allowed"]);
  assert.deepEqual(faults.filter((fault) => !/status of 403/.test(fault)), []);
  await close();
});

test("an expired token is replaced, whether or not its expiry was known", { timeout: 120_000 }, async () => {
  const { page, faults, close } = await visit();
  const old = await tokenFor(shop.url);
  await run("keys", "revoke", old.id, "--data-dir", shop.data);
  let asked = 0;
  await page.route("**/meshmend-token", async (route) => {
    asked += 1;
    return asked === 1 ? route.fulfill({ status: 201, json: { token: old.token } }) : route.continue();
  });
  await drop(page, [["box.stl", soundBox()]], BOX);
  await eventDetails(page, "repaired");
  assert.equal(asked, 2);
  await page.getByRole("button", { name: "Upload another model" }).click();
  await drop(page, [["again.stl", soundBox()]], BOX);
  await page.waitForFunction(() => events.filter(([name]) => name === "repaired").length === 2, null, { timeout: 60_000 });
  assert.equal(asked, 2, "a good one is used again");
  // A token that is about to expire is not used.
  await widget(page).evaluate(async (element) => element.setAttribute("token-url", "/meshmend-token?soon"));
  await page.route("**/meshmend-token?soon", async (route) => {
    asked += 1;
    await route.fulfill({ status: 201, json: { ...(await tokenFor(shop.url)), expires_at: new Date(Date.now() - 1000).toISOString() } });
  });
  for (const name of ["b.stl", "c.stl"]) {
    await page.getByRole("button", { name: "Upload another model" }).click();
    await drop(page, [[name, soundBox()]], BOX);
    await page.getByRole("heading", { name: "Already printable" }).waitFor({ timeout: 60_000 });
  }
  assert.equal(asked, 4);
  assert.deepEqual(faults, []);
  await close();
});

test("tokens may come from a function, and without any the widget says what is missing", { timeout: 60_000 }, async () => {
  const { page, faults, close } = await visit();
  const { token } = await tokenFor(shop.url);
  await widget(page).evaluate((element) => element.removeAttribute("token-url"));
  await drop(page, [["box.stl", soundBox()]], BOX);
  await widget(page).getByText("The upload is not set up yet").waitFor();
  assert.equal((await eventDetails(page, "failed"))[0].code, "token_missing");
  await widget(page).evaluate((element, token) => (element.getToken = async () => token), token);
  await page.getByRole("button", { name: "Try again" }).click();
  await eventDetails(page, "repaired");
  await page.getByRole("button", { name: "Upload another model" }).click();
  await widget(page).evaluate((element) => (element.getToken = null, element.setAttribute("token-url", "/nowhere")));
  await drop(page, [["box.stl", soundBox()]], BOX);
  await widget(page).getByText("did not permit the upload").waitFor();
  assert.deepEqual(faults, []);
  await close();
});

test("a token function that was set before the script loaded is called", { timeout: 60_000 }, async () => {
  const { page, close } = await open(browser, shop.url, { path: "/shop.css" });
  let go;
  await page.route("**/widget.js", async (route) => {
    await new Promise((resolve) => (go = resolve));
    await route.continue();
  });
  const { token } = await tokenFor(shop.url);
  await page.goto(shop.url, { waitUntil: "commit" });
  await widget(page).waitFor({ state: "attached" });
  await widget(page).evaluate((element, token) => (element.removeAttribute("token-url"), (element.getToken = async () => token)), token);
  go();
  await page.getByText("Drop your 3D model here").waitFor();
  await drop(page, [["box.stl", soundBox()]], BOX);
  await page.getByRole("heading", { name: "Already printable" }).waitFor({ timeout: 60_000 });
  await close();
});

test("the widget accepts one model at a time", { timeout: 60_000 }, async () => {
  const { page, faults, close } = await visit();
  await drop(page, [["a.stl", soundBox()], ["b.stl", soundBox()]], BOX);
  await page.getByText("drop a single file").waitFor();
  assert.deepEqual(await page.evaluate(() => events), []);
  await drop(page, [["a.stl", soundBox()]], BOX);
  await eventDetails(page, "repaired");
  assert.equal(await page.getByText("drop a single file").count(), 0);
  assert.deepEqual(faults, []);
  await close();
});

test("without WebGL the service's picture is shown under the same policy", { timeout: 60_000 }, async () => {
  const { page, close, faults } = await visit();
  await page.evaluate(() => {
    const { getContext } = HTMLCanvasElement.prototype;
    HTMLCanvasElement.prototype.getContext = function (kind, ...more) {
      return kind === "2d" ? getContext.call(this, kind, ...more) : null;
    };
  });
  await drop(page, [["ring.stl", brokenRing()]], BOX);
  const picture = page.getByRole("img", { name: "After" });
  await picture.waitFor({ timeout: 60_000 });
  await page.waitForFunction(() => document.querySelector("meshmend-upload").shadowRoot.querySelector("canvas").width > 300);
  await settled(page);
  assert.ok((await pixels(page, LOOKS)).grey > 5000);
  assert.deepEqual(faults.filter((fault) => !/WebGL/.test(fault)), []);
  await close();
});

test("an upload is paused, resumed and canceled", { timeout: 120_000 }, async () => {
  const { page, faults, close } = await visit();
  const session = await page.context().newCDPSession(page);
  await session.send("Network.enable");
  const upload = (bytes) =>
    session.send("Network.emulateNetworkConditions", { offline: false, latency: 0, downloadThroughput: -1, uploadThroughput: bytes });
  await upload(60_000);
  await drop(page, [["ring.stl", brokenRing()]], BOX);
  await page.getByRole("button", { name: "Pause" }).click();
  await page.getByText("Paused").waitFor();
  await page.getByRole("button", { name: "Continue" }).click();
  await page.getByRole("button", { name: "Cancel" }).click();
  await page.getByText("Drop your 3D model here").waitFor();
  assert.deepEqual((await eventDetails(page, "failed")).map(({ code, jobId }) => [code, jobId]), [["canceled", null]]);
  await drop(page, [["ring.stl", brokenRing()]], BOX);
  await page.getByRole("button", { name: "Pause" }).click();
  await upload(-1);
  await page.getByRole("button", { name: "Continue" }).click();
  await eventDetails(page, "repaired");
  assert.equal((await eventDetails(page, "uploaded")).length, 1);
  assert.deepEqual(faults, []);
  await close();
});

test("an order form has the job's id as the widget's value", { timeout: 60_000 }, async () => {
  const { page, close } = await visit();
  await widget(page).evaluate((element) => {
    const form = document.createElement("form");
    element.replaceWith(form);
    form.append(element);
    element.setAttribute("name", "model");
  });
  await drop(page, [["box.stl", soundBox()]], BOX);
  const [{ jobId }] = await eventDetails(page, "repaired");
  assert.equal(await page.evaluate(() => new FormData(document.querySelector("form")).get("model")), jobId);
  await close();
});

/** Serves one document on a separate origin. */
async function serving(made, use) {
  const server = createServer(async (_, answer) => answer.writeHead(200, { "content-type": "text/html" }).end(await made(url)));
  await new Promise((resolve) => server.listen(0, "127.0.0.1", resolve));
  const url = `http://127.0.0.1:${server.address().port}`;
  await use(url);
  server.closeAllConnections();
  server.close();
}

for (const [how, type] of [
  ["a plain script in the head", ""],
  ["a module", ' type="module"'],
]) {
  test(`it works as ${how}`, { timeout: 120_000 }, async () => {
    const made = async (origin) => {
      const { token } = await tokenFor(origin);
      const head = `<title>Shop</title><link rel="icon" href="data:,"><script${type} src="${shop.meshmend}/widget.js"></script>`;
      return `<!doctype html><html lang="en"><head>${head}</head><body><meshmend-upload token="${token}"></meshmend-upload></body></html>`;
    };
    await serving(made, async (url) => {
      const { page, faults, close } = await visit({ url });
      await drop(page, [["ring.stl", brokenRing()]], BOX);
      await shown(page);
      await page.getByRole("heading", { name: "Repaired and printable" }).waitFor();
      assert.deepEqual(faults, []);
      await close();
    });
  });
}
