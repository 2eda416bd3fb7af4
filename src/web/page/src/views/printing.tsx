import { useEffect } from "preact/hooks";
import type { Job } from "meshmend-client";
import { unitOf, upOfJob } from "../report/summary";
import { choose, settings } from "../state/settings";
import { fit, inMillimetres } from "../units";
import { usePageWords } from "../words/page-locale";
import { useStore } from "./use-store";
import type { Shown } from "./viewer-pane";

/** Build volumes of common printers, in millimetres. */
const PRINTERS: [string, [number, number, number]][] = [
  ["Bambu Lab A1 mini", [180, 180, 180]],
  ["Bambu Lab X1 / P1", [256, 256, 256]],
  ["Creality Ender-3", [220, 220, 250]],
  ["Prusa MINI+", [180, 180, 180]],
  ["Prusa MK4 / CORE One", [250, 210, 220]],
  ["Ultimaker S5", [330, 240, 300]],
  ["Elegoo Mars 4 (resin)", [153, 78, 165]],
  ["Formlabs Form 4 (resin)", [200, 125, 210]],
];

/** The size of the result, and whether it fits into a printer. */
export function Printing({ job, shown }: { job: Job; shown: Shown | null }) {
  const { words, figures } = usePageWords();
  const { unit, printer, room: mine } = useStore(settings);
  const report = job.report?.mode === "repair" ? job.report : null;
  const print = report?.after?.print ?? report?.before.print ?? null;
  const unitInMm = report ? inMillimetres(unitOf(report)) : 1;
  const size = print?.size_mm ?? null;
  const room = printer === "own" ? mine : (PRINTERS.find(([name]) => name === printer)?.[1] ?? null);
  // The model's size along the printer's x, y and z.
  const standing = size && upOfJob(job) === "y" ? [size[0]!, size[2]!, size[1]!] : size;
  const fits = standing && room ? fit(standing, room) : null;
  useEffect(() => {
    shown?.viewer.setBuildVolume(room && room.map((side) => side / unitInMm), fits !== "no");
  }, [shown, room?.join(), unitInMm, fits]);
  if (!print || !size) return null;
  return (
    <section class="printing">
      <h2>{words.printing}</h2>
      <dl>
        <dt>{words.size}</dt>
        <dd>{figures.box(size, unit)}</dd>
        {print.volume != null && (
          <>
            <dt>{words.volume}</dt>
            <dd>{figures.volume(print.volume * unitInMm ** 3, unit)}</dd>
          </>
        )}
        {print.area != null && (
          <>
            <dt>{words.area}</dt>
            <dd>{figures.area(print.area * unitInMm ** 2, unit)}</dd>
          </>
        )}
      </dl>
      <label class="field">
        {words.printer}
        <select value={printer} onChange={(event) => choose({ printer: event.currentTarget.value })}>
          <option value="">{words.printers.none}</option>
          {PRINTERS.map(([name, sides]) => (
            <option key={name} value={name}>
              {name} · {sides.join(" × ")}
            </option>
          ))}
          <option value="own">{words.printers.own}</option>
        </select>
      </label>
      {printer === "own" && (
        <fieldset class="room">
          <legend>{words.room}</legend>
          {mine.map((side, k) => (
            <input
              key={k}
              type="number"
              min={1}
              max={10000}
              aria-label={"XYZ"[k]}
              value={side}
              onInput={(event) => {
                const value = Number(event.currentTarget.value);
                if (value > 0) choose({ room: mine.map((it, i) => (i === k ? value : it)) as [number, number, number] });
              }}
            />
          ))}
        </fieldset>
      )}
      <p class={`fits ${fits ?? "none"}`} role="status">
        {fits ? words.fits[fits] : ""}
      </p>
    </section>
  );
}
