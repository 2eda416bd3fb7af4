// Settings of a model: its unit, its size and the thickness of an open surface; and refused settings.
import assert from "node:assert/strict";
import { test } from "node:test";
import { LOOKS, drop, open, pixels, settled, shown } from "./support/browser.mjs";
import { browser, service } from "./support/service-and-browser.mjs";
import { colouredGlb, coloured3mf } from "./support/coloured.mjs";
import { sheet, soundBox, thinWall } from "./support/models.mjs";
import { repaired } from "./support/service.mjs";

/** The newest job. */
async function newest() {
  const { jobs } = await (await fetch(`${service.url}/v1/jobs?limit=1`)).json();
  return (await fetch(`${service.url}/v1/jobs/${jobs[0].id}?include=report`)).json();
}

const uploads = (asked) => asked.filter((url) => /\/v1\/uploads$/.test(url)).length;

test("a file is read in another unit without another upload", { timeout: 120_000 }, async () => {
  const { page, faults, asked, close } = await open(browser, service.url);
  await drop(page, [["box.stl", soundBox()]]);
  await shown(page);
  await page.getByText("The file states no unit; mm is assumed.").waitFor();
  await page.getByLabel("Unit of the file").selectOption("in");
  await page.getByRole("button", { name: "Run again with these settings" }).click();
  await page.getByText("The lengths of the file are read as in, as requested.").waitFor({ timeout: 60_000 });
  await page.locator(".printing").getByText("1,016 × 762 × 508 mm").waitFor();
  const job = await newest();
  assert.deepEqual([job.options.unit, job.options.scale_to], ["in", "mm"], "the numbers of an STL file are millimetres for other programs");
  assert.deepEqual(job.report.after.print.size_mm, [1016, 762, 508]);
  assert.equal(uploads(asked), 1);
  assert.equal(await page.getByText("The file states no unit.").count(), 0, "it is not assumed any more");
  assert.deepEqual(faults, []);
  await close();
});

for (const [name, bytes, size] of [
  ["box.stl", soundBox, [100, 75, 50]],
  ["boxes.glb", colouredGlb, [500 / 6, 100, 200 / 6]],
]) {
  test(`${name} is scaled to another size`, { timeout: 120_000 }, async () => {
    const { page, faults, asked, close } = await open(browser, service.url);
    await drop(page, [[name, bytes()]]);
    await shown(page);
    await page.getByLabel("Longest side in mm").fill("0");
    await page.getByText("Enter a size greater than 0.").waitFor();
    assert.ok(await page.getByRole("button", { name: "Run again with these settings" }).isDisabled());
    await page.getByLabel("Longest side in mm").fill("100");
    await page.getByRole("button", { name: "Run again with these settings" }).click();
    await page.waitForFunction(() => document.querySelectorAll(".file.good").length === 2, null, { timeout: 60_000 });
    const job = await newest();
    const found = job.report.before.print.size_mm;
    assert.ok(found.every((side, k) => Math.abs(side - size[k]) < 1e-3), `${found}`);
    assert.equal(job.outcome, "already_printable");
    assert.equal(uploads(asked), 2);
    assert.deepEqual(faults, []);
    await close();
  });
}

test("without the file the page asks for it, and accepts no other", { timeout: 120_000 }, async () => {
  const job = await repaired(service.url, "box.stl", soundBox());
  const { page, faults, close } = await open(browser, service.url, { path: `/#/result/${job.id}` });
  await shown(page);
  await page.getByLabel("Longest side in mm").fill("80");
  await page.getByText("The page no longer has box.stl.").waitFor();
  const choose = async (buffer) => {
    const dialog = page.waitForEvent("filechooser");
    await page.getByRole("button", { name: "Choose the file again" }).click();
    await (await dialog).setFiles({ name: "box.stl", mimeType: "model/stl", buffer });
  };
  await choose(thinWall());
  await page.getByText("You chose a different file. Please choose box.stl.").waitFor();
  await choose(soundBox());
  await page.getByRole("button", { name: "Run again with these settings" }).click();
  await page.locator(".printing").getByText("80 × 60 × 40 mm").waitFor({ timeout: 60_000 });
  assert.deepEqual(faults, []);
  await close();
});

test("a format that the page can't scale says so", { timeout: 60_000 }, async () => {
  const { page, close } = await open(browser, service.url);
  await drop(page, [["boxes.3mf", coloured3mf()]]);
  await shown(page);
  await page.getByText("The file says that its lengths are in mm.").waitFor();
  await page.getByLabel("Longest side in mm").fill("80");
  await page.getByText("The page cannot scale 3MF files.").waitFor();
  assert.ok(await page.getByRole("button", { name: "Run again with these settings" }).isDisabled());
  await close();
});

test("an open surface gets the thickness that was chosen, after a preview of it", { timeout: 120_000 }, async () => {
  const { page, faults, asked, close } = await open(browser, service.url);
  await drop(page, [["sheet.obj", sheet()]]);
  await shown(page);
  await page.getByText("This model is an open surface without a thickness.").waitFor();
  const teal = async () => (await settled(page), (await pixels(page, LOOKS, [0.51, 1])).teal);
  assert.ok((await teal()) < 50, "there is no preview");
  await page.getByRole("button", { name: "2 mm", exact: true }).click();
  const seen = await teal();
  assert.ok(seen > 3000, `${seen} pixels of the preview`);
  assert.ok(await page.getByLabel("Show a preview in the viewer").isChecked());
  await page.getByRole("slider", { name: "Thickness in mm" }).fill("4");
  assert.ok((await teal()) > 1.1 * seen, "a thicker one is larger");
  await page.getByRole("spinbutton", { name: "Thickness in mm" }).fill("0.4");
  await page.getByText("Most printers need at least 0.8 mm.").waitFor();
  await page.getByLabel("Show a preview in the viewer").uncheck();
  assert.ok((await teal()) < 50, "there is no preview");
  await page.getByRole("spinbutton", { name: "Thickness in mm" }).fill("1.5");
  await page.getByRole("button", { name: "Make it 1.5 mm thick" }).click();
  await page.getByText("This open surface was given a thickness of 1.5 mm.").waitFor({ timeout: 60_000 });
  await page.getByText("1 open surface was given a thickness of 1.5 mm.").waitFor();
  const job = await newest();
  assert.deepEqual([job.options.open_sheets, job.options.thickness, job.outcome], ["thicken", 1.5, "repaired"]);
  assert.equal(uploads(asked), 1);
  // The result can be made again with a larger thickness.
  await shown(page);
  await page.getByRole("button", { name: "2 mm", exact: true }).click();
  await page.getByRole("button", { name: "Make it 2 mm thick" }).click();
  await page.getByText("This open surface was given a thickness of 2 mm.").waitFor({ timeout: 60_000 });
  assert.deepEqual(faults, []);
  await close();
});

test("a thickness that the service chose is reported with what printers need", { timeout: 60_000 }, async () => {
  const job = await repaired(service.url, "sheet.obj", sheet(), { open_sheets: "thicken" });
  const { page, faults, close } = await open(browser, service.url, { path: `/#/result/${job.id}`, locale: "de-DE" });
  await shown(page);
  await page.getByText("Diese offene Fläche erhielt eine Dicke von 0,086 mm.").waitFor();
  await page.getByText("Die meisten Drucker brauchen mindestens 0,8 mm.").first().waitFor();
  await page.getByRole("button", { name: "1,2 mm dick machen" }).waitFor();
  assert.deepEqual(faults, []);
  await close();
});

test("a thickness in the unit of a file that was read as inches is the same in millimetres", { timeout: 120_000 }, async () => {
  const job = await repaired(service.url, "sheet.obj", sheet(), { unit: "in" });
  const { page, faults, close } = await open(browser, service.url, { path: `/#/result/${job.id}` });
  await shown(page);
  await page.getByRole("button", { name: "2 mm", exact: true }).click();
  await page.getByRole("button", { name: "Make it 2 mm thick" }).click();
  await page.getByText("This open surface was given a thickness of 2 mm.").waitFor({ timeout: 60_000 });
  assert.ok(Math.abs((await newest()).options.thickness - 2 / 25.4) < 1e-6);
  assert.deepEqual(faults, []);
  await close();
});

test("a wall that most printers can't make is named", { timeout: 60_000 }, async () => {
  const { page, close } = await open(browser, service.url);
  await drop(page, [["wall.stl", thinWall()]]);
  await page.getByText("The thinnest wall is 0.5 mm. Most printers need at least 0.8 mm.").waitFor({ timeout: 60_000 });
  await close();
});

test("a click replaces an assumption by another decision", { timeout: 120_000 }, async () => {
  const { page, faults, close } = await open(browser, service.url);
  await page.getByRole("button", { name: "Try a broken sample" }).click();
  await page.getByText("Where surfaces cross, the direction of the faces decided what is solid.").waitFor({ timeout: 60_000 });
  await page.getByRole("button", { name: "Choose differently" }).click();
  await page.waitForFunction(() => document.querySelectorAll(".file.good, .file.fair").length === 2, null, { timeout: 60_000 });
  assert.equal((await newest()).options.winding_rule, "nonzero");
  assert.deepEqual(faults, []);
  await close();
});

test("a refused option is reported beside its field, whether errors are texts or objects", { timeout: 120_000 }, async () => {
  const job = await repaired(service.url, "box.stl", soundBox());
  const { page, faults, close } = await open(browser, service.url, { path: `/#/jobs/${job.id}` });
  const problem = (errors) => ({ type: "/problems/invalid_options", title: "Invalid options", status: 400, code: "invalid_options", detail: "Two options are wrong.", errors });
  let errors = [{ field: "deadline_s", message: "`deadline_s` must be 1 to 3600." }, { field: "weld", message: "There is no option `weld`." }];
  await page.route("**/v1/jobs", (route) => route.fulfill({ status: 400, contentType: "application/problem+json", body: JSON.stringify(problem(errors)) }));
  await page.getByRole("button", { name: "Run again" }).click();
  await page.locator("label", { hasText: "Seconds" }).getByText("`deadline_s` must be 1 to 3600.").waitFor();
  const note = page.locator(".retry .problem");
  await note.getByText("There is no option `weld`.").waitFor();
  assert.equal(await note.getByText("deadline_s").count(), 0, "it is said once");
  errors = ["The first text.", "The second text."];
  await page.getByRole("button", { name: "Run again" }).click();
  for (const text of errors) await note.getByText(text).waitFor();
  assert.deepEqual(faults.filter((fault) => !/status of 400/.test(fault)), []);
  await close();
});

test("a link to the result is copied, and another browser can open it", { timeout: 60_000 }, async () => {
  const { page, faults, close } = await open(browser, service.url, { permissions: ["clipboard-read", "clipboard-write"] });
  await drop(page, [["box.stl", soundBox()]]);
  await shown(page);
  await page.getByText("Anyone who can reach this service can open the link.").waitFor();
  await page.getByRole("button", { name: "Copy the link" }).click();
  await page.getByText("The link is copied.").waitFor();
  const link = await page.evaluate(() => navigator.clipboard.readText());
  assert.match(link, new RegExp(`^${service.url}/#/result/job_\\w+$`));
  assert.equal(await page.getByLabel("Link to this result").inputValue(), link);
  assert.deepEqual(faults, []);
  await close();
  const other = await open(browser, service.url, { path: link.slice(service.url.length) });
  await other.page.getByRole("heading", { name: "Already printable" }).waitFor();
  await other.close();
});

test("if the service has deleted the file, the page asks for it and continues", { timeout: 120_000 }, async () => {
  const job = await repaired(service.url, "box.stl", soundBox());
  const { page, faults, close } = await open(browser, service.url, { path: `/#/result/${job.id}` });
  await shown(page);
  const gone = { type: "/problems/job_expired", title: "Expired", status: 410, code: "job_expired", detail: "The files of the job have expired." };
  let isAsked = false;
  await page.route("**/v1/jobs", (route) => {
    if (isAsked) return route.continue();
    isAsked = true;
    return route.fulfill({ status: 410, contentType: "application/problem+json", body: JSON.stringify(gone) });
  });
  await page.getByLabel("Unit of the file").selectOption("cm");
  await page.getByRole("button", { name: "Run again with these settings" }).click();
  await page.getByText("The page no longer has box.stl. Choose the file again").waitFor();
  const dialog = page.waitForEvent("filechooser");
  await page.getByRole("button", { name: "Choose the file again" }).click();
  await (await dialog).setFiles({ name: "box.stl", mimeType: "model/stl", buffer: soundBox() });
  await page.locator(".printing").getByText("400 × 300 × 200 mm").waitFor({ timeout: 60_000 });
  assert.deepEqual(faults.filter((fault) => !/status of 410/.test(fault)), []);
  await close();
});
