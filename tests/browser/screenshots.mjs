// Makes the README's pictures, in docs/pictures.
import { mkdirSync } from "node:fs";
import { join } from "node:path";
import { drop, launch, open, settled, shown } from "./support/browser.mjs";
import { brokenRing, sheet, thinWall } from "./support/models.mjs";
import { repaired, serve } from "./support/service.mjs";

const folder = new URL("../../docs/pictures", import.meta.url).pathname;
mkdirSync(folder, { recursive: true });
const [service, browser] = await Promise.all([serve(), launch()]);

async function picture(name, options, then) {
  const { page, close } = await open(browser, service.url, { reducedMotion: "reduce", viewport: { width: 1440, height: 900 }, ...options });
  await page.getByText(/STL, OBJ|ring\.stl/).first().waitFor();
  await then(page);
  await settled(page);
  await page.screenshot({ path: join(folder, `${name}.png`) });
  await close();
  console.log(`docs/pictures/${name}.png`);
}

try {
  const repair = async (page) => {
    await drop(page, [["ring.stl", brokenRing()]]);
    await shown(page);
  };
  await picture("page", {}, repair);
  await picture("page-dark", { colorScheme: "dark" }, async (page) => {
    await repair(page);
    await page.getByRole("button", { name: "Slider" }).click();
    await page.getByRole("button", { name: "Wireframe" }).click();
  });
  await picture("page-phone", { viewport: { width: 390, height: 780 }, deviceScaleFactor: 2, isMobile: true, hasTouch: true }, repair);
  await repaired(service.url, "terrain.obj", sheet());
  await repaired(service.url, "phone-stand.stl", thinWall());
  await repaired(service.url, "cut-off.stl", Buffer.from("solid cut\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\n"));
  await picture("jobs", { path: "/#/jobs" }, (page) => page.getByText("The service is ready").waitFor());
} finally {
  await browser.close();
  await service.stop();
}
