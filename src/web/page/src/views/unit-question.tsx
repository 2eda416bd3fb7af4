import { useState } from "preact/hooks";
import type { Job, Options, Report } from "meshmend-client";
import { optionsOf } from "../report/advice";
import { fileUnit, unitChoices, withUnit } from "../report/settings";
import { useWords } from "../words/locale";

interface Props {
  job: Job;
  report: Report;
  /** Submits another job with other options. */
  retry: (options: Options) => void;
  heading?: "h2" | "h3";
}

/** Asks for the unit if the service doubts it, with the size under each candidate, or for the height if the unit says nothing. */
export function UnitQuestion({ job, report, retry, heading: Heading = "h2" }: Props) {
  const { words, figures } = useWords();
  const [height, setHeight] = useState("");
  const doubt = report.unit_candidates;
  if (!doubt || job.status === "expired") return null;
  const now = fileUnit(report);
  const mm = Number(height.replace(",", "."));
  const send = (event: Event): void => {
    event.preventDefault();
    if (mm > 0) retry({ ...optionsOf(job), target_height_mm: mm });
  };
  return (
    <section class="unit-question" aria-labelledby={`unit-${job.id}`}>
      <Heading id={`unit-${job.id}`}>{words.askSize}</Heading>
      <p>{doubt.normalised ? words.askHeight : words.askUnit(now)}</p>
      {doubt.normalised ? (
        <form onSubmit={send} noValidate>
          <label class="field">
            {words.heightInMm}
            <input type="number" min={0} step="any" inputMode="decimal" value={height} onInput={(event) => setHeight(event.currentTarget.value)} />
          </label>
          <button type="submit" class="plain" disabled={!(mm > 0)}>
            {words.runWithSize}
          </button>
        </form>
      ) : (
        <ul class="units">
          {unitChoices(report).map(({ unit, size, wall }) => (
            <li key={unit}>
              <button type="button" class="plain" aria-pressed={unit === now} onClick={() => retry(withUnit(job, report, unit))}>
                {words.unitNames[unit] ?? unit} · {figures.box(size.map((side) => Number(side.toPrecision(3))), "mm")}
              </button>
              {wall != null && <span class="aside">{words.wallsOf(figures.length(wall, "mm", 2))}</span>}
            </li>
          ))}
        </ul>
      )}
    </section>
  );
}
