// Chromium for the tests, and checks of what is on the screen.
import { readFileSync } from "node:fs";
import { createRequire } from "node:module";
import { after } from "node:test";
import { chromium } from "playwright-core";

const AXE = readFileSync(createRequire(import.meta.url).resolve("axe-core/axe.min.js"), "utf8");

const ARGUMENTS = [
  "--no-sandbox",
  "--disable-quic",
  "--no-first-run",
  "--disable-background-networking",
  "--disable-component-update",
  "--disable-sync",
  // WebGL on the processor, since test machines have no graphics card.
  "--use-angle=swiftshader",
  "--enable-unsafe-swiftshader",
];

export function launch() {
  return chromium.launch({ executablePath: process.env.MESHMEND_BROWSER ?? "/usr/bin/chromium", headless: true, args: ARGUMENTS });
}

/** A browser for all tests of a file, which ends together with other resources. */
export async function launchBeside(service) {
  const browser = await launch().catch(async (error) => {
    await service.stop();
    throw error;
  });
  after(async () => {
    await browser.close();
    await service.stop();
  });
  return browser;
}

/** A new page that fails the test on an error or a violation of the page's policy. */
export async function open(browser, url, { path = "/", ...options } = {}) {
  const context = await browser.newContext({ viewport: { width: 1360, height: 900 }, locale: "en-US", ...options });
  const page = await context.newPage();
  const faults = [];
  page.on("pageerror", (error) => faults.push(String(error.stack ?? error)));
  page.on("console", (message) => {
    if (message.type() === "error" && !/status of (401|404)/.test(message.text())) faults.push(message.text());
  });
  const asked = [];
  page.on("request", (request) => asked.push(request.url()));
  await page.goto(url + path);
  return { page, faults, asked, close: () => context.close() };
}

/** The violations that axe-core finds in a page. It is injected past the page's policy, as developer tools are. */
export async function violations(page) {
  await page.evaluate(AXE);
  const found = await page.evaluate(() => globalThis.axe.run(document, { resultTypes: ["violations"] }));
  return found.violations.flatMap(({ id, nodes }) => nodes.map((node) => `${id}: ${node.html} (${node.failureSummary})`));
}

/** Drops files on the page or an element. */
export async function drop(page, files, over = "body") {
  const carried = await page.evaluateHandle((files) => {
    const data = new DataTransfer();
    for (const { name, text } of files) {
      const bytes = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
      data.items.add(new File([bytes], name));
    }
    return data;
  }, files.map(([name, bytes]) => ({ name, text: bytes.toString("base64") })));
  await page.dispatchEvent(over, "dragenter", { dataTransfer: carried });
  await page.dispatchEvent(over, "drop", { dataTransfer: carried });
}

/** Waits until the whole model is on the canvas and the camera does not move. */
export async function shown(page, timeout = 60_000) {
  await page.locator("canvas[data-ready]").waitFor({ timeout });
  await settled(page);
}

export async function settled(page) {
  await page.evaluate(async () => {
    for (let i = 0; i < 3; i += 1) await new Promise((resolve) => requestAnimationFrame(resolve));
  });
}

/** Reads the pixels of the canvas, or of a part given in fractions from 0 to 1, as one of two summaries. */
async function read(page, summary, looks, [left, right]) {
  const picture = (await page.locator("canvas").screenshot()).toString("base64");
  // A page without a policy, since it reads data URLs.
  const reader = await page.context().newPage();
  try {
    return await reader.evaluate(
      async ({ picture, summary, looks, left, right }) => {
        const bytes = Uint8Array.from(atob(picture), (letter) => letter.charCodeAt(0));
        const image = await createImageBitmap(new Blob([bytes]));
        const canvas = new OffscreenCanvas(image.width, image.height);
        const context = canvas.getContext("2d");
        context.drawImage(image, 0, 0);
        const from = Math.round(image.width * left);
        const width = Math.round(image.width * right) - from;
        const { data } = context.getImageData(from, 0, width, image.height);
        const counts = Object.fromEntries(looks.map(([name]) => [name, 0]));
        const ends = Object.fromEntries(looks.map(([name]) => [name, null]));
        for (let i = 0; i < data.length; i += 4) {
          const [r, g, b] = [data[i], data[i + 1], data[i + 2]];
          const [x, y] = [from + ((i / 4) % width), Math.floor(i / 4 / width)];
          for (const [name, [low, high]] of looks) {
            if (r < low[0] || r > high[0] || g < low[1] || g > high[1] || b < low[2] || b > high[2]) continue;
            counts[name] += 1;
            const now = (ends[name] ??= { left: [x, y], right: [x, y], top: [x, y], bottom: [x, y] });
            if (x < now.left[0]) now.left = [x, y];
            if (x > now.right[0]) now.right = [x, y];
            if (y > now.bottom[1]) now.bottom = [x, y];
          }
        }
        return summary === "counts" ? counts : ends;
      },
      { picture, summary, looks, left, right },
    );
  } finally {
    await reader.close();
  }
}

/** Counts the pixels of the canvas by colour range; of a part given in fractions from 0 to 1. */
export function pixels(page, looks, part = [0, 1]) {
  return read(page, "counts", looks, part);
}

/** The outermost pixels in each colour range: leftmost, rightmost, topmost and bottommost. */
export function ends(page, looks, part = [0, 1]) {
  return read(page, "ends", looks, part);
}

/** Ranges of colours on the canvas, lit and in shade. */
export const LOOKS = [
  ["orange", [[170, 110, 0], [255, 180, 60]]],
  ["red", [[90, 0, 0], [235, 70, 60]]],
  ["blue", [[0, 60, 100], [40, 140, 215]]],
  ["grey", [[110, 110, 110], [215, 215, 215]]],
  ["pink", [[190, 60, 140], [255, 120, 200]]],
  ["teal", [[10, 90, 80], [95, 190, 180]]],
];

/** The colours of the models of coloured.mjs, lit and in shade. */
export const PAINTS = [
  ["red", [[90, 0, 0], [255, 50, 50]]],
  ["blue", [[0, 20, 90], [50, 90, 255]]],
  ["yellow", [[130, 110, 0], [255, 245, 90]]],
  ["grey", [[110, 110, 110], [215, 215, 215]]],
];
