import { listen } from "../shared/following.js";

const SAID_MS = 1500;

// Copies the code beside a button of class fw-copy; where the page may not, the code is selected instead.
export function listenToCopies(page) {
  async function copy(event) {
    const button = page.holds(event.target) && event.target.closest(".fw-copy"), code = button && codeBeside(button);
    if (!code) return;
    try {
      await navigator.clipboard.writeText(code.textContent);
      const before = button.textContent;
      button.textContent = "copied";
      setTimeout(() => { button.textContent = before; }, SAID_MS);
    } catch {
      getSelection().selectAllChildren(code);
    }
  }
  return listen(document, { click: copy });
}

const codeBeside = (button) => button.parentElement.querySelector("code");
