import type { Job } from "meshmend-client";
import { isOpenSheet } from "../report/advice";
import { isPrintable } from "../report/outcome";
import { inWords, stillWrong } from "../report/plain";
import type { Unit } from "../units";
import { useWords } from "../words/words";
import { Icon } from "./icons";

/** The verdict and what was done, in plain words. */
export function Verdict({ job, unit, heading: Heading }: { job: Job; unit: Unit; heading: "h1" | "h2" }) {
  const { words, figures } = useWords();
  const report = job.report?.mode === "repair" ? job.report : null;
  const good = isPrintable(job.outcome);
  const title = job.status === "succeeded" ? words.outcomes[job.outcome ?? ""] : job.status === "failed" ? words.failed : words[job.status === "canceled" ? "canceled" : "expired"];
  const left = report && !good ? stillWrong(report, words, figures) : "";
  return (
    <section class={good ? "verdict good" : job.status === "failed" ? "verdict bad" : "verdict fair"}>
      <p class="file-name">{job.input.name}</p>
      <Heading>
        <span class="seal">
          <Icon name={good ? "check" : "warn"} size={22} />
        </span>
        {title}
      </Heading>
      {report && isOpenSheet(report) && <p>{words.openSurface}</p>}
      {report && (
        <ul class="deeds">
          {inWords(report, words, figures, unit).map((line) => (
            <li key={line}>{line}</li>
          ))}
        </ul>
      )}
      {left && <p class="left">{words.left(left)}</p>}
      {good && report?.after && <p class="proof">{words.proven}</p>}
      {report && report.red_flags.length > 0 && (
        <div class="flags">
          <p>{words.flags}</p>
          <ul>
            {report.red_flags.map((flag) => (
              <li key={flag.code}>
                <strong>{words.flagNames[flag.code] ?? flag.code}</strong>: <span lang="en">{flag.detail}</span>
              </li>
            ))}
          </ul>
        </div>
      )}
      {job.reused_from && <p class="aside">{words.reused}</p>}
    </section>
  );
}
