import { useState } from "preact/hooks";
import { type Capabilities, type FieldError, type Job, Problem } from "meshmend-client";
import { isRepair, optionsOf } from "../report/advice";
import { withProcess } from "../report/print-ready";
import { again } from "../state/items";
import { usePageWords } from "../words/page-locale";
import { ProblemNote } from "./problem-note";
import { ProcessSelect } from "./process-select";

/** The service's defaults, for jobs that do not list their options. */
const DEFAULTS = { preset: "auto", output: "auto", open_sheets: "auto", max_tier: 3, deadline_s: 300, interior: "auto", islands: "auto", voids: "keep", require: "any" };
/** Options that are lengths in millimetres and have no default. */
const LENGTHS = ["min_wall", "vent_diameter_mm", "target_height_mm", "target_longest_mm"] as const;
const FIELDS = [...Object.keys(DEFAULTS), ...LENGTHS, "process"];

/** A form that submits another job for the same file, with changed options. */
export function RetryForm({ job, can }: { job: Job; can: Capabilities | null }) {
  const { words } = usePageWords();
  const [options, change] = useState(() => ({ ...DEFAULTS, ...optionsOf(job) }) as Record<string, unknown>);
  const [problem, setProblem] = useState<Problem | null>(null);
  if (!isRepair(job) || job.status === "expired" || !can) return null;
  const set = (name: string, value: unknown): void => change((all) => ({ ...all, [name]: value }));
  const errorsOf = (name: string): readonly FieldError[] => (problem?.errors ?? []).filter(({ field }) => field === name || field?.endsWith(`.${name}`));
  const wrong = (name: string) =>
    errorsOf(name).map(({ message }) => (
      <span key={message} class="wrong">
        {message}
      </span>
    ));
  const choice = (name: string, label: string, values: string[]) => (
    <label class="field">
      {label}
      <select value={String(options[name])} onChange={(event) => set(name, event.currentTarget.value)}>
        {values.map((it) => (
          <option key={it}>{it}</option>
        ))}
      </select>
      {wrong(name)}
    </label>
  );
  const length = (name: (typeof LENGTHS)[number]) => (
    <label class="field" key={name}>
      {words.printOptions[name]}
      <input
        type="number"
        min={0}
        step="any"
        value={options[name] == null ? "" : Number(options[name])}
        onInput={(event) => set(name, event.currentTarget.value === "" ? undefined : Number(event.currentTarget.value))}
      />
      {wrong(name)}
    </label>
  );
  const send = (event: Event): void => {
    event.preventDefault();
    again(job, options)
      .then(() => (location.hash = "#/"))
      .catch((error: unknown) => setProblem(Problem.from(error)));
  };
  const named = FIELDS.flatMap(errorsOf);
  return (
    <form class="retry" onSubmit={send}>
      <h2>{words.retryWith}</h2>
      <div class="fields">
        {choice("preset", words.preset, can.presets)}
        {choice("output", words.output, ["auto", ...can.output_formats, "same"])}
        {choice("open_sheets", words.openSheets, ["auto", "leave", "thicken", "base"])}
        <label class="field">
          {words.maxTier}
          <select value={String(options["max_tier"])} onChange={(event) => set("max_tier", Number(event.currentTarget.value))}>
            {[1, 2, 3].map((tier) => (
              <option key={tier} value={tier}>
                {tier} · {words.tierNames[tier]}
              </option>
            ))}
          </select>
          {wrong("max_tier")}
        </label>
        <label class="field">
          {words.deadline}
          <input type="number" min={1} max={3600} required value={Number(options["deadline_s"])} onInput={(event) => set("deadline_s", Number(event.currentTarget.value))} />
          {wrong("deadline_s")}
        </label>
        <ProcessSelect value={String(options["process"] ?? "")} set={(process) => change((all) => withProcess(all, process))} label={words.process} />
        {wrong("process")}
        {choice("require", words.printOptions.require, ["any", "printable", "print_ready"])}
        {length("min_wall")}
        {choice("interior", words.printOptions.interior, ["auto", "keep", "fill"])}
        {choice("islands", words.printOptions.islands, ["auto", "keep", "drop", "attach"])}
        {choice("voids", words.printOptions.voids, ["keep", "fill", "vent"])}
        {LENGTHS.slice(1).map(length)}
      </div>
      {problem && <ProblemNote problem={problem} without={named} />}
      <button type="submit" class="primary">
        {words.runAgain}
      </button>
    </form>
  );
}
