// The viewer: models in their own colours and upright, marks that match the verdict, and distances.
import assert from "node:assert/strict";
import { test } from "node:test";
import { LOOKS, PAINTS, drop, ends, open, pixels, settled, shown } from "./support/browser.mjs";
import { colouredGlb, colouredObj, colouredOff, colouredPly, coloured3mf } from "./support/coloured.mjs";
import { browser, service } from "./support/service-and-browser.mjs";
import { flatFace, openBox, soundBox } from "./support/models.mjs";

const LEFT = [0, 0.49];
const RIGHT = [0.51, 1];

/** Waits until the colours of the files are on the canvas too. */
async function coloured(page) {
  await page.locator("canvas[data-coloured]").waitFor({ timeout: 60_000 });
  await settled(page);
}

for (const [name, bytes, second, hasAfter] of [
  ["boxes.glb", colouredGlb, "yellow", true],
  ["boxes.zip", colouredObj, "yellow", true],
  ["boxes.ply", colouredPly, "blue", true],
  ["boxes.3mf", coloured3mf, "blue", true],
  // The service writes the result of an OFF file as STL, which has no colours.
  ["boxes.off", colouredOff, "blue", false],
]) {
  test(`${name} is shown in its own colours and stands upright`, { timeout: 120_000 }, async () => {
    const { page, faults, close } = await open(browser, service.url);
    await drop(page, [[name, bytes()]]);
    await coloured(page);
    const [left, right] = [await pixels(page, PAINTS, LEFT), await pixels(page, PAINTS, RIGHT)];
    assert.ok(left.red > 5000 && left[second] > 5000, `before: ${JSON.stringify(left)}`);
    if (hasAfter) assert.ok(right.red > 5000 && right[second] > 5000, `after: ${JSON.stringify(right)}`);
    const { red } = await ends(page, PAINTS, LEFT);
    const [width, height] = [red.right[0] - red.left[0], red.bottom[1] - red.top[1]];
    assert.ok(height > 1.5 * width, `the red box is ${width} wide and ${height} tall`);
    await page.getByRole("button", { name: "Original colours" }).click();
    await settled(page);
    const grey = await pixels(page, PAINTS, LEFT);
    assert.ok(grey.red + grey[second] < 50 && grey.grey > 10_000, `without colours: ${JSON.stringify(grey)}`);
    assert.deepEqual(faults, []);
    await close();
  });
}

test("defects are marked on a model in its own colours", { timeout: 120_000 }, async () => {
  const { page, faults, close } = await open(browser, service.url);
  const broken = colouredPly().toString().replace("element face 12", "element face 11").trimEnd().split("\n").slice(0, -1).join("\n");
  await drop(page, [["broken.ply", Buffer.from(`${broken}\n`)]]);
  await coloured(page);
  const seen = { ...(await pixels(page, PAINTS, LEFT)), ...(await pixels(page, LOOKS.slice(0, 1), LEFT)) };
  assert.ok(seen.red > 5000 && seen.blue > 5000 && seen.orange > 50, JSON.stringify(seen));
  assert.deepEqual(faults, []);
  await close();
});

test("a model without colours has no colour switch", { timeout: 60_000 }, async () => {
  const { page, close } = await open(browser, service.url);
  await drop(page, [["box.stl", soundBox()]]);
  await coloured(page);
  assert.equal(await page.getByRole("button", { name: "Original colours" }).count(), 0);
  await close();
});

test("a printable result has only marks that the verdict mentions", { timeout: 60_000 }, async () => {
  const { page, faults, close } = await open(browser, service.url);
  await drop(page, [["flat.obj", flatFace()]]);
  await shown(page);
  await page.getByRole("heading", { name: "Already printable" }).waitFor();
  const { jobs } = await (await fetch(`${service.url}/v1/jobs?limit=1`)).json();
  assert.ok("defects.glb" in jobs[0].artifacts && !("remaining.glb" in jobs[0].artifacts), "nothing that the verdict names remains");
  const colour = await page.locator(".layer .swatch").first().evaluate((element) => getComputedStyle(element).backgroundColor.match(/\d+/g).map(Number));
  const marks = [["marks", [colour.map((part) => part - 25), colour.map((part) => part + 25)]]];
  await page.getByRole("button", { name: "Before", exact: true }).click();
  await settled(page);
  assert.ok((await pixels(page, marks)).marks > 20, "it is marked on the model that came");
  await page.getByRole("button", { name: "After", exact: true }).click();
  await settled(page);
  assert.equal((await pixels(page, marks)).marks, 0);
  assert.deepEqual(faults, []);
  await close();
});

test("two points are measured along each axis, and cleared", { timeout: 60_000 }, async () => {
  const { page, faults, close } = await open(browser, service.url);
  await drop(page, [["box.stl", soundBox()]]);
  await shown(page);
  await page.getByRole("button", { name: "Before", exact: true }).click();
  await settled(page);
  // The front corner at the bottom and the one at the upper left, each a little within the box: the ruler takes the corners themselves.
  await page.locator(".over").evaluate((over) => (over.style.display = "none"));
  const { grey } = await ends(page, LOOKS);
  await page.locator(".over").evaluate((over) => (over.style.display = ""));
  const click = ([x, y], dx, dy) => page.locator("canvas").click({ position: { x: x + dx, y: y + dy } });
  await page.getByRole("button", { name: "Measure a distance" }).click();
  await page.getByText("Pick two points on the model.").waitFor();
  await click(grey.bottom, 0, -4);
  await page.getByText("Pick the second point.").waitFor();
  await click(grey.left, 4, 2);
  for (const text of ["Distance: 44.72 mm", "X: 40 mm", "Y: 0 mm", "Z: 20 mm"]) await page.getByText(text, { exact: true }).waitFor();
  await page.getByLabel("Unit", { exact: true }).selectOption("cm");
  await page.getByText("Distance: 4.472 cm").waitFor();
  await page.getByRole("button", { name: "Clear" }).click();
  await page.getByText("Pick two points on the model.").waitFor();
  await click([10, 10], 0, 0);
  await page.getByText("There is no model at this point.").waitFor();
  // A drag turns the model and picks nothing.
  const box = await page.locator("canvas").boundingBox();
  await page.mouse.move(box.x + box.width / 2, box.y + box.height / 2);
  await page.mouse.down();
  await page.mouse.move(box.x + box.width / 2 + 60, box.y + box.height / 2, { steps: 4 });
  await page.mouse.up();
  assert.equal(await page.getByText("Pick the second point.").count(), 0);
  await page.getByRole("button", { name: "Close" }).click();
  assert.equal(await page.locator(".ruler").count(), 0);
  assert.deepEqual(faults, []);
  await close();
});

test("the ruler works with the keyboard", { timeout: 60_000 }, async () => {
  const { page, faults, close } = await open(browser, service.url);
  await drop(page, [["box.stl", soundBox()]]);
  await shown(page);
  await page.getByRole("button", { name: "Measure a distance" }).press("Enter");
  await page.getByText("Pick two points on the model.").waitFor();
  const canvas = page.locator("canvas");
  await canvas.press("Enter");
  await page.getByText("Pick the second point.").waitFor();
  await page.locator(".pin.cross").waitFor({ state: "attached" });
  for (let i = 0; i < 5; i += 1) await canvas.press("ArrowRight");
  await canvas.press("Enter");
  const text = await page.locator(".ruler .whole").textContent();
  const length = Number(/^Distance: ([\d.]+) mm$/.exec(text)?.[1]);
  const along = await page.locator(".ruler .along span").evaluateAll((all) => all.map((element) => Number(/: ([\d.]+) mm/.exec(element.textContent)[1])));
  assert.ok(length > 1 && Math.abs(Math.hypot(...along) - length) < 0.01 * length, `${text}: ${along}`);
  await canvas.press("Escape");
  await page.getByText("Pick two points on the model.").waitFor();
  assert.deepEqual(faults, []);
  await close();
});

test("the ruler works with a finger", { timeout: 60_000 }, async () => {
  const { page, faults, close } = await open(browser, service.url, { viewport: { width: 360, height: 740 }, hasTouch: true, isMobile: true });
  await drop(page, [["box.stl", soundBox()]]);
  await shown(page);
  await page.getByRole("button", { name: "Before", exact: true }).tap();
  await page.getByRole("button", { name: "Measure a distance" }).tap();
  await page.getByText("Pick two points on the model.").waitFor();
  await page.locator("canvas").scrollIntoViewIfNeeded();
  const box = await page.locator("canvas").boundingBox();
  await page.touchscreen.tap(box.x + box.width * 0.3, box.y + box.height * 0.5);
  await page.touchscreen.tap(box.x + box.width * 0.6, box.y + box.height * 0.5);
  await page.getByText(/^Distance: [\d.]+ mm$/).waitFor();
  assert.equal(await page.evaluate(() => document.documentElement.scrollWidth), 360);
  assert.deepEqual(faults, []);
  await close();
});

test("a large closed hole is reported as an assumption in both languages", { timeout: 60_000 }, async () => {
  for (const [locale, texts] of [
    ["en-US", [/% of the surface is new\. Its shape is a guess\./, /1 large hole was closed\. The shape of the patch is a guess/, /The file states no unit\. Its lengths were read as mm\./]],
    ["de-DE", [/% der Oberfläche sind neu\. Ihre Form ist geraten\./, /1 großes Loch wurde geschlossen\. Die Form des Flickens ist geraten/, /Die Datei gibt keine Einheit an\. Ihre Längen wurden als mm gelesen\./]],
  ]) {
    const { page, faults, close } = await open(browser, service.url, { locale });
    await drop(page, [["open.stl", openBox()]]);
    for (const text of texts) await page.locator(".verdict").getByText(text).first().waitFor({ timeout: 60_000 });
    assert.deepEqual(faults, []);
    await close();
  }
});
