import { useEffect, useState } from "preact/hooks";
import type { Job, Options, Report } from "meshmend-client";
import { LEAST_WALL_MM } from "../report/remarks";
import { lengthIn, openSurfaceOf, withThickness } from "../report/settings";
import { unitOf } from "../report/summary";
import type { Viewer } from "../viewer/viewer";
import { useWords } from "../words/locale";

/** Common wall thicknesses in millimetres: two, three and five lines of a 0.4 mm nozzle. */
const PRESETS_MM = [0.8, 1.2, 2];
const [LEAST_MM, MOST_MM] = [0.4, 6];

interface Props {
  job: Job;
  report: Report;
  /** The viewer for the preview, once it is loaded. */
  viewer: Viewer | null;
  retry: (options: Options) => void;
  heading?: "h2" | "h3";
}

/** The thickness of an open surface, with a preview and a form to run again with another thickness. */
export function Thickness({ job, report, viewer, retry, heading: Heading = "h2" }: Props) {
  const { words, figures } = useWords();
  const surface = openSurfaceOf(job);
  const isPrintable = (surface?.mm ?? 0) >= LEAST_WALL_MM;
  const [text, setText] = useState(() => String(isPrintable ? Number(surface!.mm!.toPrecision(3)) : 1.2));
  const [isPreviewed, preview] = useState(false);
  const [isMissing, setMissing] = useState(false);
  const mm = Number(text.replace(",", "."));
  const isValid = Number.isFinite(mm) && mm > 0 && mm <= 1000;
  const inMm = (length: number): string => figures.length(length, "mm", 2);
  useEffect(() => {
    if (!viewer || !surface) return;
    const length = isPreviewed && isValid ? lengthIn(mm, unitOf(report)) : null;
    setMissing(!viewer.setShell(length) && length !== null);
    return () => void viewer.setShell(null);
  }, [viewer, mm, isPreviewed]);
  if (!surface) return null;
  const send = (event: Event): void => {
    event.preventDefault();
    if (isValid) retry(withThickness(job, report, mm));
  };
  const change = (next: string): void => {
    setText(next);
    preview(true);
  };
  return (
    <form class="thickness" onSubmit={send} noValidate>
      <Heading>{words.thickness}</Heading>
      <p>{surface.mm === null ? words.notThickYet : (surface.is === "base" ? words.basedBy : words.thickenedBy)(inMm(surface.mm))}</p>
      {surface.mm !== null && !isPrintable && <p class="wrong">{words.thinnerThan(inMm(LEAST_WALL_MM))}</p>}
      <div class="segments" role="group" aria-label={words.thicknessPresets}>
        {PRESETS_MM.map((preset) => (
          <button key={preset} type="button" aria-pressed={mm === preset} onClick={() => change(String(preset))}>
            {inMm(preset)}
          </button>
        ))}
      </div>
      <div class="amount">
        <input type="range" min={LEAST_MM} max={MOST_MM} step={0.1} value={isValid ? mm : LEAST_MM} aria-label={words.thicknessIn} onInput={(event) => change(event.currentTarget.value)} />
        <label>
          <span class="hidden">{words.thicknessIn}</span>
          <input type="number" min={0} step={0.1} inputMode="decimal" value={text} aria-invalid={!isValid} onInput={(event) => change(event.currentTarget.value)} /> mm
        </label>
      </div>
      {isValid && mm < LEAST_WALL_MM && <p class="aside">{words.thinnerThan(inMm(LEAST_WALL_MM))}</p>}
      {!isValid && <p class="wrong">{words.noSize}</p>}
      <label class="check">
        <input type="checkbox" checked={isPreviewed} onChange={(event) => preview(event.currentTarget.checked)} /> {words.thicknessPreview}
      </label>
      {isMissing && (
        <p class="aside" role="status">
          {words.noThicknessPreview}
        </p>
      )}
      <button type="submit" class="primary" disabled={!isValid || surface.mm !== null && Math.abs(surface.mm - mm) < 1e-6}>
        {words.makeThick(isValid ? inMm(mm) : "–")}
      </button>
    </form>
  );
}
