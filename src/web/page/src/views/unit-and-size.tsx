import { useRef, useState } from "preact/hooks";
import { type FieldError, type Job, type Options, Problem, type Report } from "meshmend-client";
import { optionsOf } from "../report/advice";
import { FILE_UNITS, fileUnit, sizeIn, withUnit } from "../report/settings";
import { isScalable, scaledCopy } from "../state/scale";
import { useWords } from "../words/locale";
import { ProblemNote } from "./problem-note";

interface Props {
  job: Job;
  report: Report;
  /** The uploaded file, if the page still has it. */
  file: File | null;
  /** Submits another job for the file on the service. */
  retry: (options: Options) => void;
  /** Uploads a file and submits it as a job. */
  send: (file: File, options: Options) => void;
  heading?: "h2" | "h3";
}

/** The unit and the size of a model, with a form to run again with others. */
export function UnitAndSize({ job, report, file, retry, send, heading: Heading = "h2" }: Props) {
  const { words, figures } = useWords();
  const now = fileUnit(report);
  const [unit, setUnit] = useState(now);
  const [wanted, setWanted] = useState<string | null>(null);
  const [chosen, setChosen] = useState<File | null>(null);
  const [note, setNote] = useState("");
  const [problem, setProblem] = useState<Problem | null>(null);
  const input = useRef<HTMLInputElement>(null);
  const size = sizeIn(report, unit);
  if (!size) return null;
  const format = job.input.format;
  const longest = Math.max(...size);
  const shown = Number(longest.toPrecision(6));
  const side = wanted === null ? shown : Number(wanted);
  const isSized = wanted !== null && side !== shown;
  const isUnit = unit !== now || (report.unit?.source === "assumed" && !("unit" in optionsOf(job)));
  const source = file ?? chosen;
  const needsFile = isSized && isScalable(format) && !source;
  const isBlocked = isSized && (!isScalable(format) || !(side > 0) || needsFile);

  const choose = (given: File | undefined): void => {
    if (!given) return;
    const isSame = given.size === job.input.bytes;
    setChosen(isSame ? given : null);
    setNote(isSame ? "" : words.otherFile(job.input.name));
  };
  const run = async (event: Event): Promise<void> => {
    event.preventDefault();
    if (isBlocked) return;
    const options = withUnit(job, report, unit);
    if (!isSized) return retry(options);
    try {
      send(await scaledCopy(source!, format, side / longest), options);
    } catch (error) {
      setProblem(Problem.from(error));
    }
  };
  const errors: FieldError[] = problem ? problem.errors.filter(({ field }) => field === "unit") : [];
  return (
    <form class="unit-and-size" onSubmit={(event) => void run(event)} noValidate>
      <Heading>{words.unitAndSize}</Heading>
      <p class="aside">{words.unitSource[report.unit?.source ?? "assumed"]?.(now)}</p>
      <label class="field">
        {words.fileUnit}
        <select value={unit} onChange={(event) => setUnit(event.currentTarget.value)} aria-invalid={errors.length > 0}>
          {FILE_UNITS.map((name) => (
            <option key={name} value={name}>
              {name} · {figures.box(sizeIn(report, name)!.map((length) => Number(length.toPrecision(3))), "mm")}
            </option>
          ))}
        </select>
      </label>
      {errors.map(({ message }) => (
        <p key={message} class="wrong">
          {message}
        </p>
      ))}
      <label class="field">
        {words.longestSide}
        <input type="number" min={0} step="any" inputMode="decimal" value={wanted ?? String(shown)} aria-invalid={isSized && !(side > 0)} onInput={(event) => setWanted(event.currentTarget.value)} />
      </label>
      {isSized && !(side > 0) && <p class="wrong">{words.noSize}</p>}
      {isSized && side > 0 && <p class="aside">{isScalable(format) ? words.longestSideMore : words.cannotScale(format.toUpperCase())}</p>}
      {needsFile && side > 0 && (
        <>
          <p class="aside">{words.chooseAgainMore(job.input.name)}</p>
          <input ref={input} type="file" hidden onChange={(event) => choose(event.currentTarget.files?.[0])} />
          <button type="button" class="plain" onClick={() => input.current?.click()}>
            {words.chooseAgain}
          </button>
          {note && (
            <p class="wrong" role="alert">
              {note}
            </p>
          )}
        </>
      )}
      {problem && <ProblemNote problem={problem} without={errors} />}
      <button type="submit" class="plain" disabled={isBlocked || !(isSized || isUnit)}>
        {words.runWithSize}
      </button>
    </form>
  );
}
