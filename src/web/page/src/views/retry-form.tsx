import { useState } from "preact/hooks";
import type { Capabilities, Job } from "meshmend-client";
import { own } from "../report/advice";
import { again } from "../state/work";
import { useWords } from "../words/words";

/** Makes another job of the same file, with some options changed. */
export function RetryForm({ job, can }: { job: Job; can: Capabilities | null }) {
  const { words } = useWords();
  const [options, change] = useState(() => own(job));
  if (job.options["mode"] !== "repair" || job.status === "expired" || !can) return null;
  const set = (name: string, value: unknown): void => change((all) => ({ ...all, [name]: value }));
  const choice = (name: string, label: string, values: string[]) => (
    <label class="field">
      {label}
      <select value={String(options[name])} onChange={(event) => set(name, event.currentTarget.value)}>
        {values.map((it) => (
          <option key={it}>{it}</option>
        ))}
      </select>
    </label>
  );
  const send = (event: Event): void => {
    event.preventDefault();
    location.hash = "#/";
    again(job, options);
  };
  return (
    <form class="retry" onSubmit={send}>
      <h2>{words.retryWith}</h2>
      <div class="fields">
        {choice("preset", words.preset, ["auto", ...can.presets])}
        {choice("output", words.output, [...can.output_formats, "same"])}
        {choice("open_sheets", words.openSheets, ["auto", "thicken", "base"])}
        <label class="field">
          {words.maxTier}
          <select value={String(options["max_tier"])} onChange={(event) => set("max_tier", Number(event.currentTarget.value))}>
            {[1, 2, 3].map((tier) => (
              <option key={tier} value={tier}>
                {tier} · {words.tierNames[tier]}
              </option>
            ))}
          </select>
        </label>
        <label class="field">
          {words.deadline}
          <input type="number" min={1} max={3600} required value={Number(options["deadline_s"])} onInput={(event) => set("deadline_s", Number(event.currentTarget.value))} />
        </label>
      </div>
      <button type="submit" class="primary">
        {words.runAgain}
      </button>
    </form>
  );
}
