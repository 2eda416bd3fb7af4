import { useState } from "preact/hooks";
import { type Capabilities, type FieldError, type Job, Problem } from "meshmend-client";
import { isRepair, optionsOf } from "../report/advice";
import { withProcess } from "../report/print-ready";
import { again } from "../state/items";
import { usePageWords } from "../words/page-locale";
import { ProblemNote } from "./problem-note";
import { ProcessSelect } from "./process-select";

/** The service's defaults, for jobs that do not list their options. */
const DEFAULTS = { preset: "auto", output: "auto", open_sheets: "auto", max_tier: 3, deadline_s: 300, interior: "auto", islands: "auto", voids: "keep", wall_growth: "both", require: "any" };
/** Options that are lengths in millimetres, or volumes in mm³, and have no default. */
const LENGTHS = ["min_wall", "seal_mm", "keep_cavities_over_mm3", "vent_diameter_mm", "target_height_mm", "target_longest_mm"] as const;
const SWITCHES = ["thicken_to_process", "alternatives"] as const;
const FIELDS = [...Object.keys(DEFAULTS), ...LENGTHS, ...SWITCHES, "process", "process_limits"];

/** A form that submits another job for the same file, with changed options. */
export function RetryForm({ job, can }: { job: Job; can: Capabilities | null }) {
  const { words } = usePageWords();
  const [options, change] = useState(() => ({ ...DEFAULTS, ...optionsOf(job) }) as Record<string, unknown>);
  const [limitsText, setLimitsText] = useState(() => limitsAsText(optionsOf(job)["process_limits"]));
  const [isMalformed, setMalformed] = useState(false);
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
  const isOn = (name: (typeof SWITCHES)[number], label: string) => (
    <label class="check" key={name}>
      <input type="checkbox" checked={options[name] === true} onChange={(event) => set(name, event.currentTarget.checked)} /> {label} {wrong(name)}
    </label>
  );
  const send = (event: Event): void => {
    event.preventDefault();
    const limits = parsedLimits(limitsText);
    setMalformed(limits === null);
    if (limits === null) return;
    const { process_limits: _, ...others } = options;
    again(job, limits ? { ...others, process_limits: limits } : others)
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
        <ProcessSelect
          value={String(options["process"] ?? "")}
          set={(process) => {
            change((all) => withProcess(all, process));
            setLimitsText("");
          }}
          label={words.process}
        />
        {wrong("process")}
        {options["process"] && (
          <label class="field">
            {words.printOptions.process_limits}
            <textarea rows={2} spellcheck={false} placeholder={'{"free_wall_mm": 1.2}'} value={limitsText} aria-invalid={isMalformed} onInput={(event) => setLimitsText(event.currentTarget.value)} />
            {isMalformed && <span class="wrong">{words.malformedLimits}</span>}
            {wrong("process_limits")}
          </label>
        )}
        {choice("require", words.printOptions.require, ["any", "printable", "print_ready"])}
        {length("min_wall")}
        {options["process"] && isOn("thicken_to_process", words.printOptions.thicken_to_process)}
        {choice("wall_growth", words.printOptions.wall_growth, ["both", "outward", "inward"])}
        {choice("interior", words.printOptions.interior, ["auto", "keep", "fill"])}
        {choice("islands", words.printOptions.islands, ["auto", "keep", "drop", "attach"])}
        {choice("voids", words.printOptions.voids, ["keep", "fill", "vent"])}
        {LENGTHS.slice(1).map(length)}
        {isOn("alternatives", words.printOptions.alternatives)}
      </div>
      {problem && <ProblemNote problem={problem} without={named} />}
      <button type="submit" class="primary">
        {words.runAgain}
      </button>
    </form>
  );
}

/** The limits of a job as JSON text; empty without limits. */
function limitsAsText(limits: unknown): string {
  return limits ? JSON.stringify(limits) : "";
}

/** The limits in a text: undefined if it is empty, null if it is no JSON object. */
function parsedLimits(text: string): object | undefined | null {
  if (text.trim() === "") return undefined;
  try {
    const value: unknown = JSON.parse(text);
    return typeof value === "object" && value !== null && !Array.isArray(value) ? value : null;
  } catch {
    return null;
  }
}
