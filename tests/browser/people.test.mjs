// Accessibility of the page: screen readers, keyboards, dark mode, phones, languages, and services that require a key.
import assert from "node:assert/strict";
import { mkdtempSync, readFileSync } from "node:fs";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { before, test } from "node:test";
import { drop, open, shown, violations } from "./support/browser.mjs";
import { browser, service } from "./support/service-and-browser.mjs";
import { brokenRing, sheet } from "./support/models.mjs";
import { repaired, run, serveFrom } from "./support/service.mjs";

let ring, failed;
before(async () => {
  ring = await repaired(service.url, "ring.stl", brokenRing());
  failed = await repaired(service.url, "cut.stl", Buffer.from("solid cut\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\n"));
  await repaired(service.url, "sheet.obj", sheet());
});
/** Every view of the page, and the element to wait for before it is checked. */
const places = () => [
  ["/", (page) => page.getByText("STL, OBJ").waitFor()],
  [`/#/result/${ring.id}`, (page) => shown(page)],
  [`/#/result/${failed.id}`, (page) => page.getByText("Code: bad_input").waitFor()],
  ["/#/jobs", (page) => page.getByRole("link", { name: "ring.stl" }).waitFor()],
  [`/#/jobs/${ring.id}`, (page) => page.getByRole("heading", { name: "ring.stl" }).waitFor()],
];

for (const colorScheme of ["light", "dark"]) {
  test(`axe-core finds nothing wrong in the ${colorScheme}`, { timeout: 180_000 }, async () => {
    for (const [path, ready] of places()) {
      const { page, faults, close } = await open(browser, service.url, { path, colorScheme, reducedMotion: "reduce" });
      await ready(page);
      for (const summary of await page.locator("summary").all()) await summary.click();
      assert.deepEqual(await violations(page), [], path);
      assert.deepEqual(faults, [], path);
      await close();
    }
  });
}

test("the switch for dark mode overrides the system's setting and is remembered", { timeout: 60_000 }, async () => {
  const { page, close } = await open(browser, service.url, { colorScheme: "light" });
  const ground = () => page.evaluate(() => getComputedStyle(document.body).backgroundColor);
  const light = await ground();
  const button = page.getByRole("button", { name: /^Appearance/ });
  await button.click();
  await button.click();
  await page.getByRole("button", { name: "Appearance: Dark" }).waitFor();
  const dark = await ground();
  assert.notEqual(dark, light);
  await page.reload();
  await page.getByText("STL, OBJ").waitFor();
  assert.equal(await ground(), dark);
  await close();
});

test("everything is reachable with the keyboard, and the focus is visible", { timeout: 60_000 }, async () => {
  const { page, close } = await open(browser, service.url, { path: `/#/result/${ring.id}` });
  await shown(page);
  const wanted = new Set(await page.locator("main").locator("button:not([disabled]), select:not([disabled]), canvas, summary, [role=slider]").evaluateAll((all) => all.map((element, i) => ((element.dataset.nth = String(i)), String(i)))));
  assert.ok(wanted.size > 20, `${wanted.size} things to reach`);
  for (let i = 0; i < 120 && wanted.size > 0; i += 1) {
    await page.keyboard.press("Tab");
    const { nth, outline } = await page.evaluate(() => {
      const now = document.activeElement;
      const parts = [now, ...now.querySelectorAll("*")].map((element) => getComputedStyle(element));
      return { nth: now.dataset.nth, outline: parts.some((style) => style.outlineStyle !== "none" && Number.parseFloat(style.outlineWidth) > 1) };
    });
    if (nth === undefined) continue;
    assert.ok(outline, `the focus on ${nth} is seen`);
    wanted.delete(nth);
  }
  assert.deepEqual([...wanted], [], "every control was reached");
  await close();
});

test("the skip link leads past the navigation", { timeout: 60_000 }, async () => {
  const { page, close } = await open(browser, service.url);
  await page.getByText("STL, OBJ").waitFor();
  await page.keyboard.press("Tab");
  assert.equal(await page.evaluate(() => document.activeElement.textContent), "Skip to the content");
  await page.keyboard.press("Enter");
  await page.keyboard.press("Tab");
  assert.equal(await page.evaluate(() => document.activeElement.textContent.trim()), "Choose files");
  await close();
});

test("on a phone nothing is wider than the screen, and the slider is visible", { timeout: 120_000 }, async () => {
  for (const [path, ready] of places()) {
    for (const locale of ["en-US", "de-DE"]) {
      const { page, close } = await open(browser, service.url, { path, locale, viewport: { width: 360, height: 740 }, hasTouch: true, isMobile: true });
      await (locale === "en-US" ? ready(page) : page.locator("h1").first().waitFor());
      const wide = await page.evaluate(() => [document.documentElement.scrollWidth, innerWidth]);
      assert.ok(wide[0] <= 360 && wide[1] <= 360, `${path} in ${locale}: ${wide}`);
      if (path.startsWith("/#/result/") && path.includes(ring.id) && locale === "en-US") {
        assert.equal(await page.getByRole("button", { name: "Slider" }).getAttribute("aria-pressed"), "true");
      }
      await close();
    }
  }
});

test("a phone has links to all pages of the service", { timeout: 60_000 }, async () => {
  for (const [locale, names] of [["en-US", ["Repair", "Jobs", "Docs"]], ["de-DE", ["Reparieren", "Aufträge", "Doku"]]]) {
    const { page, close } = await open(browser, service.url, { locale, viewport: { width: 360, height: 740 }, hasTouch: true, isMobile: true });
    for (const name of names) {
      const box = await page.getByRole("link", { name, exact: true }).boundingBox();
      assert.ok(box && box.x >= 0 && box.x + box.width <= 360 && box.height >= 36, `${name}: ${JSON.stringify(box)}`);
    }
    await close();
  }
});

test("the viewer has no empty column beside or below it", { timeout: 60_000 }, async () => {
  for (const locale of ["en-US", "de-DE"]) {
    const { page, close } = await open(browser, service.url, { path: `/#/result/${ring.id}`, locale });
    await shown(page);
    const box = (part) => page.locator(part).evaluate((element) => element.getBoundingClientRect().toJSON());
    const [viewer, tools, side] = [await box(".viewer"), await box(".tools-of-viewer"), await box(".side")];
    assert.ok(tools.top - viewer.bottom < 40 && tools.left === viewer.left && Math.abs(tools.right - viewer.right) < 1, JSON.stringify({ viewer, tools }));
    assert.ok(side.left - viewer.right < 40, JSON.stringify({ viewer, side }));
    const wide = await page.evaluate(() =>
      [...document.querySelectorAll("main *")].filter((element) => !element.closest("canvas, .over, .hidden, pre") && element.scrollWidth > element.clientWidth + 1 && getComputedStyle(element).overflowX === "visible" && element.clientWidth > 0).map((element) => element.outerHTML.slice(0, 120)),
    );
    assert.deepEqual(wide, [], `nothing is wider than its place in ${locale}`);
    await close();
  }
});

test("the handle between before and after has arrows and not the strokes of a pause", { timeout: 60_000 }, async () => {
  const { page, close } = await open(browser, service.url, { path: `/#/result/${ring.id}` });
  await shown(page);
  await page.getByRole("button", { name: "Slider" }).click();
  const turned = await page.locator(".grip").evaluate((element) => ["::before", "::after"].map((part) => getComputedStyle(element, part).transform));
  assert.ok(turned.every((transform) => transform.startsWith("matrix")) && turned[0] !== turned[1], `${turned}`);
  await close();
});

test("the layout does not shift while the page loads", { timeout: 60_000 }, async () => {
  for (const path of ["/", "/#/jobs", `/#/result/${ring.id}`]) {
    const { page, close } = await open(browser, service.url, { path: "/livez" });
    await page.addInitScript(() => {
      globalThis.shift = 0;
      new PerformanceObserver((list) => {
        for (const entry of list.getEntries()) globalThis.shift += entry.value;
      }).observe({ type: "layout-shift", buffered: true });
    });
    await page.goto(service.url + path);
    await page.locator("h1").first().waitFor();
    if (path.includes("result")) await shown(page);
    await page.waitForLoadState("networkidle").catch(() => {});
    // Web Vitals call less than 0.1 good.
    const shift = await page.evaluate(() => globalThis.shift);
    assert.ok(shift < 0.1, `${path} moves by ${shift}`);
    await close();
  }
});

test("a German browser gets the page in German and can switch to English", { timeout: 60_000 }, async () => {
  const { page, close } = await open(browser, service.url, { locale: "de-AT" });
  await page.getByRole("heading", { name: "3D-Modell ablegen" }).waitFor();
  assert.equal(await page.evaluate(() => document.documentElement.lang), "de");
  await drop(page, [["ring.stl", brokenRing()]]);
  await page.getByText("2 Löcher geschlossen", { exact: true }).waitFor({ timeout: 60_000 });
  await page.getByLabel("Sprache").selectOption("en");
  await page.getByText("2 holes closed", { exact: true }).waitFor();
  assert.equal(await page.evaluate(() => document.documentElement.lang), "en");
  await close();
});

test("if the service requires a key, the page asks for it and forgets it with the tab", { timeout: 120_000 }, async () => {
  const data = mkdtempSync(join(tmpdir(), "meshmend-keys-"));
  const secret = (await run("keys", "create", "--tenant", "shop", "--scopes", "jobs:read,jobs:write", "--data-dir", data)).match(/mm\w+_\S+/)?.[0];
  assert.ok(secret, "a key was printed");
  const locked = await serveFrom(data, "--auth", "keys");
  try {
    const { page, faults, close } = await open(browser, locked.url);
    await page.getByRole("heading", { name: "This service requires a key" }).waitFor();
    assert.deepEqual(await violations(page), []);
    await page.getByLabel("API key").fill("wrong");
    await page.getByRole("button", { name: "Continue" }).click();
    await page.getByText("This key is unknown or has expired").waitFor();
    await page.getByLabel("API key").fill(secret);
    await page.getByRole("button", { name: "Continue" }).click();
    await page.getByText("STL, OBJ").waitFor();
    await drop(page, [["ring.stl", brokenRing()]]);
    await shown(page);
    const [download] = await Promise.all([page.waitForEvent("download"), page.getByRole("button", { name: "Download STL" }).click()]);
    assert.equal(download.suggestedFilename(), "ring-repaired.stl");
    await page.getByText("The link contains no key.").waitFor();
    assert.ok(!(await page.getByLabel("Link to this result").inputValue()).includes(secret));
    assert.ok(readFileSync(await download.path()).length > 1000);
    const kept = await page.evaluate(() => [JSON.stringify(sessionStorage), JSON.stringify(localStorage), document.cookie]);
    assert.ok(kept[0].includes(secret) && !kept[1].includes(secret) && kept[2] === "", "in the tab's memory only");
    await page.getByRole("link", { name: "Jobs" }).click();
    await page.getByText("The metrics require a key with the scope metrics").waitFor();
    await page.getByRole("button", { name: "Forget the key" }).click();
    await page.getByRole("heading", { name: "This service requires a key" }).waitFor();
    assert.deepEqual(faults.filter((fault) => !/status of 403/.test(fault)), []);
    await close();
  } finally {
    await locked.stop();
  }
});
