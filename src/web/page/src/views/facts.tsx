/** A list of names with values. */
export function Facts({ list, look }: { list: readonly (readonly [string, string])[]; look: string }) {
  return (
    <dl class={look}>
      {list.map(([name, value]) => (
        <div key={name}>
          <dt>{name}</dt>
          <dd>{value}</dd>
        </div>
      ))}
    </dl>
  );
}
