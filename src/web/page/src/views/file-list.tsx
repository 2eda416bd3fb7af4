import type { Capabilities } from "meshmend-client";
import { claimsOf } from "../report/verdict";
import { type Piece, pauseUpload, remove, resume, selected } from "../state/work";
import { usePageWords } from "../words/page-words";
import { ChooseFiles } from "./choose-files";
import { Icon, type IconName } from "./icons";

interface Props {
  pieces: Piece[];
  chosen: number | null;
  take: (files: File[]) => void;
  can: Capabilities | null;
}

/** All files of this visit with their states. */
export function FileList({ pieces, chosen, take, can }: Props) {
  const { words } = usePageWords();
  return (
    <aside class="files" aria-label={words.files}>
      <ul>
        {pieces.map((piece) => (
          <Row key={piece.id} piece={piece} isChosen={piece.id === chosen} />
        ))}
      </ul>
      <ChooseFiles can={can} take={take} compact />
    </aside>
  );
}

function Row({ piece, isChosen }: { piece: Piece; isChosen: boolean }) {
  const { words, figures } = usePageWords();
  const { tone, icon, text, share } = stateOf(piece, words, figures);
  return (
    <li class={isChosen ? `file chosen ${tone}` : `file ${tone}`}>
      <button type="button" class="pick" aria-current={isChosen ? "true" : undefined} onClick={() => selected.set(piece.id)}>
        <span class="badge">{icon ? <Icon name={icon} size={16} /> : <span class="spinner" />}</span>
        <span class="text">
          <span class="name">{piece.name}</span>
          <span class="state">{text}</span>
        </span>
      </button>
      {piece.phase === "uploading" && (
        <button type="button" class="quiet" title={words.pauseNote} aria-label={`${words.pause}: ${piece.name}`} onClick={() => pauseUpload(piece.id)}>
          <Icon name="pause" size={16} />
        </button>
      )}
      {(piece.phase === "paused" || (piece.phase === "refused" && piece.file && !piece.job)) && (
        <button type="button" class="quiet" title={words.pauseNote} aria-label={`${words.resume}: ${piece.name}`} onClick={() => resume(piece.id)}>
          <Icon name="play" size={16} />
        </button>
      )}
      {!["uploading", "submitting"].includes(piece.phase) && (
        <button type="button" class="quiet" aria-label={`${words.remove}: ${piece.name}`} title={words.remove} onClick={() => remove(piece.id)}>
          <Icon name="cross" size={16} />
        </button>
      )}
      {share !== null && <progress max={1} value={share} aria-label={`${words.percent}: ${piece.name}`} />}
    </li>
  );
}

interface State {
  tone: "busy" | "good" | "fair" | "bad";
  icon: IconName | null;
  text: string;
  share: number | null;
}

type Said = ReturnType<typeof usePageWords>;

function stateOf(piece: Piece, words: Said["words"], figures: Said["figures"]): State {
  const busy = (text: string, share: number | null): State => ({ tone: "busy", icon: null, text, share });
  if (piece.phase === "uploading") return busy(`${words.states.uploading} · ${figures.percent(piece.sent / Math.max(1, piece.bytes))}`, piece.sent / Math.max(1, piece.bytes));
  if (piece.phase === "paused") return { tone: "fair", icon: "pause", text: words.states.paused, share: null };
  if (piece.phase === "refused") return { tone: "bad", icon: "warn", text: words.states.refused, share: null };
  if (piece.phase === "following") {
    const percent = piece.progress?.percent ?? 0;
    const queued = piece.progress?.status === "queued";
    return busy(queued ? words.states.queued : `${words.states.running} · ${figures.percent(percent / 100)}`, percent / 100);
  }
  if (piece.phase !== "ended" || !piece.job) return busy(words.states[piece.phase === "waiting" ? "waiting" : "submitting"], null);
  const { status } = piece.job;
  if (status === "canceled") return { tone: "fair", icon: "cross", text: words.outcomes["canceled"]!, share: null };
  if (status === "expired") return { tone: "fair", icon: "cross", text: words.statuses["expired"]!, share: null };
  const { tone, title } = claimsOf(piece.job);
  return { tone, icon: tone === "good" ? "check" : "warn", text: words.outcomes[title] ?? "", share: null };
}
