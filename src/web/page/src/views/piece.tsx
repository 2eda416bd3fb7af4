import { useRef } from "preact/hooks";
import type { Capabilities } from "meshmend-client";
import { type Piece, isGone, resume, stop } from "../state/work";
import { usePageWords } from "../words/page-words";
import { ProblemNote } from "./problem-note";
import { Result } from "./result";
import { Stages } from "./stages";

/** One file: its progress or its result. */
export function PieceView({ piece, can }: { piece: Piece; can: Capabilities | null }) {
  const { words } = usePageWords();
  const input = useRef<HTMLInputElement>(null);
  if (piece.phase === "ended" && piece.job) return <Result job={piece.job} file={piece.file} can={can} />;
  if (piece.phase === "refused" && piece.problem) {
    return (
      <section class="card wide">
        <h1>{piece.name}</h1>
        <ProblemNote problem={piece.problem} />
        {!piece.file && !piece.job && isGone(piece.problem) && Object.keys(piece.options).length > 0 && (
          <>
            <p>{words.chooseAgainMore(piece.name)}</p>
            <input
              ref={input}
              type="file"
              hidden
              onChange={(event) => {
                const file = event.currentTarget.files?.[0];
                if (file) resume(piece.id, file);
              }}
            />
            <button type="button" class="primary" onClick={() => input.current?.click()}>
              {words.chooseAgain}
            </button>
          </>
        )}
        {piece.file && !piece.job && (
          <button type="button" class="primary" onClick={() => resume(piece.id)}>
            {words.retry}
          </button>
        )}
      </section>
    );
  }
  return (
    <section class="card wide">
      <h1>{piece.name}</h1>
      <Stages piece={piece} />
      <button type="button" class="plain" onClick={() => void stop(piece.id)}>
        {words.cancel}
      </button>
    </section>
  );
}
