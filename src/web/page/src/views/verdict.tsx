import type { Job } from "meshmend-client";
import { isOpenSheet } from "../report/advice";
import { inWords, stillWrong } from "../report/plain";
import { type Claims, claimsOf } from "../report/verdict";
import type { Unit } from "../units";
import { useWords } from "../words/words";
import { Icon } from "./icons";

/** The verdict and what was done, in plain words. */
export function Verdict({ job, unit, heading: Heading }: { job: Job; unit: Unit; heading: "h1" | "h2" }) {
  const { words, figures } = useWords();
  const report = job.report?.mode === "repair" ? job.report : null;
  const claims = claimsOf(job);
  const good = claims.isPrintable;
  const left = report && !good ? stillWrong(report, words, figures) : "";
  return (
    <section class={`verdict ${claims.tone}`}>
      <p class="file-name">{job.input.name}</p>
      <Heading>
        <span class="seal">
          <Icon name={good ? "check" : "warn"} size={22} />
        </span>
        {words.outcomes[claims.title]}
      </Heading>
      {report && isOpenSheet(report) && <p>{words.openSurface}</p>}
      {report && !claims.isRefused && (
        <ul class="deeds">
          {inWords(report, words, figures, unit).map((line) => (
            <li key={line}>{line}</li>
          ))}
        </ul>
      )}
      {left && <p class="left">{words.left(left)}</p>}
      {claims.proven.length > 0 && <p class="proof">{words.proven(claims.proven.map((property) => words.properties[property] ?? property).join(", "))}</p>}
      <Remarks claims={claims} />
      {job.reused_from && <p class="aside">{words.reused}</p>}
    </section>
  );
}

/** What a person should look at: red flags, what was assumed with the option that decides otherwise, and warnings. */
function Remarks({ claims: { flags, assumptions, warnings } }: { claims: Claims }) {
  const { words, figures } = useWords();
  return (
    <>
      {flags.length > 0 && (
        <div class="flags">
          <p>{words.flags}</p>
          <ul>
            {flags.map((flag) => (
              <li key={flag.detail}>
                <strong>{words.flagNames[flag.code] ?? flag.code}</strong>: <span lang="en">{flag.detail}</span>
              </li>
            ))}
          </ul>
        </div>
      )}
      {assumptions.length > 0 && (
        <div class="assumptions">
          <p>{words.assumptions}</p>
          <ul>
            {assumptions.map(({ kind, count, detail, option }) => (
              <li key={`${kind} ${detail}`}>
                <strong>{words.assumptionNames[kind]?.(figures.count(count), count) ?? kind}</strong>: <span lang="en">{detail}</span>
                {option && (
                  <span class="otherwise">
                    {" "}
                    {words.otherwise} <code>{option}</code>
                  </span>
                )}
              </li>
            ))}
          </ul>
        </div>
      )}
      {warnings.length > 0 && (
        <details class="warnings" open={warnings.length <= 3}>
          <summary>{words.warnings(figures.count(warnings.length), warnings.length)}</summary>
          <ul lang="en">
            {warnings.map((warning) => (
              <li key={warning}>{warning}</li>
            ))}
          </ul>
        </details>
      )}
    </>
  );
}
