// Accessibility of the widget: keyboards, screen readers, dark mode, phones, languages, and shops with their own style.
import assert from "node:assert/strict";
import { test } from "node:test";
import { LOOKS, drop, pixels, settled, shown, violations } from "./support/browser.mjs";
import { brokenRing, sheet } from "./support/models.mjs";
import { BOX, CUT, visit, widget } from "./support/shop-and-browser.mjs";

test("the whole widget works with the keyboard", { timeout: 120_000 }, async () => {
  const { page, faults, close } = await visit({ reducedMotion: "reduce" });
  const focused = () => page.evaluate(() => document.activeElement?.shadowRoot?.activeElement?.textContent ?? "");
  const dialog = page.waitForEvent("filechooser");
  await page.keyboard.press("Tab");
  assert.equal(await focused(), "Choose a file");
  await page.keyboard.press("Enter");
  await (await dialog).setFiles({ name: "ring.stl", mimeType: "model/stl", buffer: brokenRing() });
  await shown(page);
  const said = page.locator(`${BOX} > [role=status]`);
  assert.equal(await said.textContent(), "Repaired and printable");
  const wanted = new Set(["Slider", "Before", "After", "Show all", "canvas", "slider", "Result", "Upload another model"]);
  for (let i = 0; i < 12 && wanted.size > 0; i += 1) {
    await page.keyboard.press("Tab");
    const { name, outline } = await page.evaluate(() => {
      const now = document.activeElement.shadowRoot?.activeElement;
      if (!now) return { name: "", outline: true };
      const seen = [now, ...now.querySelectorAll("*")].map((element) => getComputedStyle(element));
      const names = { CANVAS: "canvas", DIV: now.getAttribute("role") === "slider" ? "slider" : now.ariaLabel };
      return {
        name: names[now.tagName] ?? (now.ariaLabel || now.textContent),
        outline: seen.some((style) => style.outlineStyle !== "none" && Number.parseFloat(style.outlineWidth) > 1),
      };
    });
    assert.ok(outline, `the focus on ${name} is seen`);
    wanted.delete(name);
    if (name === "canvas") {
      const before = await pixels(page, LOOKS);
      for (let n = 0; n < 8; n += 1) await page.keyboard.press("ArrowLeft");
      await settled(page);
      assert.notDeepEqual(await pixels(page, LOOKS), before, "arrows turn the model");
    }
  }
  assert.deepEqual([...wanted], [], "every control was reached");
  await page.keyboard.press("Enter");
  await page.getByText("Drop your 3D model here").waitFor();
  await page.keyboard.press("Tab");
  assert.equal(await focused(), "Choose a file", "the focus stays in the widget");
  assert.deepEqual(faults, []);
  await close();
});

for (const colorScheme of ["light", "dark"]) {
  test(`axe-core finds nothing wrong on the shop's page in the ${colorScheme}`, { timeout: 180_000 }, async () => {
    const { page, faults, close } = await visit({ colorScheme, reducedMotion: "reduce" });
    assert.deepEqual(await violations(page), []);
    const ground = await page.locator(BOX).evaluate((element) => getComputedStyle(element).backgroundColor);
    assert.equal(ground === "rgb(255, 255, 255)", colorScheme === "light", ground);
    await page.route("**/v1/jobs/*/events*", () => {});
    await drop(page, [["ring.stl", brokenRing()]], BOX);
    await page.getByRole("button", { name: "Cancel" }).waitFor();
    assert.deepEqual(await violations(page), [], "on its way");
    await page.unroute("**/v1/jobs/*/events*");
    await page.reload();
    await page.getByText("Drop your 3D model here").waitFor();
    for (const [name, bytes] of [["ring.stl", brokenRing()], ["sheet.obj", sheet()]]) {
      await drop(page, [[name, bytes]], BOX);
      await page.getByRole("heading", { name: /Repaired and printable|Not repairable/ }).waitFor({ timeout: 60_000 });
      await shown(page);
      assert.deepEqual(await violations(page), [], name);
      await page.getByRole("button", { name: "Upload another model" }).click();
    }
    await drop(page, [["cut.stl", CUT]], BOX);
    await page.getByText("Code: bad_input").waitFor();
    assert.deepEqual(await violations(page), [], "a problem");
    assert.deepEqual(faults, []);
    await close();
  });
}

test("on a phone nothing is wider than the screen, and nothing moves below the widget, in both languages", { timeout: 120_000 }, async () => {
  for (const [locale, heading] of [["en-US", "Repaired and printable"], ["de-DE", "Repariert und druckbar"]]) {
    const { page, close } = await visit({ locale, viewport: { width: 360, height: 740 }, hasTouch: true, isMobile: true });
    // The widget has the language of the shop's page, English, unless it is set.
    await widget(page).evaluate((element, lang) => (element.lang = lang), locale.slice(0, 2));
    await page.evaluate(() => {
      globalThis.shift = 0;
      new PerformanceObserver((list) => {
        for (const entry of list.getEntries()) globalThis.shift += entry.value;
      }).observe({ type: "layout-shift", buffered: true });
    });
    const below = () => page.locator("#offer-title").evaluate((element) => element.getBoundingClientRect().top + scrollY);
    const first = await below();
    await drop(page, [["ring.stl", brokenRing()]], BOX);
    await page.getByRole("heading", { name: heading }).waitFor({ timeout: 60_000 });
    await shown(page);
    assert.equal(await below(), first);
    assert.equal(await page.evaluate(() => document.documentElement.scrollWidth), 360);
    const shift = await page.evaluate(() => globalThis.shift);
    assert.ok(shift < 0.1, `moves by ${shift}`);
    await close();
  }
});

test("a shop's variables and parts style the widget, and its root font size does not", { timeout: 60_000 }, async () => {
  const { page, close } = await visit();
  const look = () => page.getByRole("button", { name: "Choose a file" }).evaluate((element) => {
    const { backgroundColor, minHeight, letterSpacing, fontFamily } = getComputedStyle(element);
    return { backgroundColor, minHeight, letterSpacing, fontFamily };
  });
  const first = await look();
  assert.equal(first.backgroundColor, "rgb(91, 42, 134)", "the demo shop's colour");
  await page.evaluate(() => {
    const sheet = new CSSStyleSheet();
    sheet.replaceSync(`
      html { font-size: 10px }
      meshmend-upload { --meshmend-accent: rgb(1, 2, 3); --meshmend-font: Georgia }
      meshmend-upload::part(button) { letter-spacing: 3px }`);
    document.adoptedStyleSheets = [sheet];
  });
  assert.deepEqual(await look(), { backgroundColor: "rgb(1, 2, 3)", minHeight: first.minHeight, letterSpacing: "3px", fontFamily: "Georgia" });
  await close();
});
