// Asks what the server wants to know before it does something.

import { html, useEffect, useRef } from "../vendor/preact-htm.js";

export function Question({ question }) {
  const dialog = useRef();
  useEffect(() => dialog.current.showModal(), []);
  const back = (event) => {
    event.preventDefault();
    question.answer(null);
  };
  return html`
    <dialog ref=${dialog} aria-labelledby="question" aria-describedby="asked" onCancel=${back}>
      <h2 id="question">${question.title}</h2>
      <p id="asked" class="file">${question.problem}</p>
      <div class="choices">
        ${question.choices.map(({ words, more }, index) => html`
          <button class=${index === 0 && question.choices.length > 1 ? "main" : ""} onClick=${() => question.answer(more)}>${words}</button>`)}
        <button autofocus=${question.choices.length === 1} onClick=${back}>Go back</button>
      </div>
    </dialog>`;
}
