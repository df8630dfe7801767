// What viser's panels lack: names for screen readers, and a word while the server is away.
(() => {
  // A row's label names all its fields: viser ties it to none.
  const named = (selector, name) => {
    for (const node of document.querySelectorAll(selector)) {
      if (!node.getAttribute("aria-label")) node.setAttribute("aria-label", name);
    }
  };
  setInterval(() => {
    for (const label of document.querySelectorAll(".mantine-Flex-root label")) {
      const row = label.closest(".mantine-Flex-root");
      for (const field of row.querySelectorAll("input, textarea, [role='slider']")) {
        if (!field.labels?.length && !field.getAttribute("aria-label")) {
          field.setAttribute("aria-label", label.textContent);
        }
      }
    }
    named("button:has(.tabler-icon-list-search)", "Command palette (Ctrl+K)");
    named("[role='progressbar']", "Accepted");
    named(".mantine-Notification-closeButton", "Close");
  }, 500);

  // viser (1.1.1, makeThrottledMessageSender) sends a field's value at most every 50 ms and keeps
  // one waiting message for all fields, so a second field that changes replaces the first one's
  // value. Its script is changed as it is loaded: the first one's value is sent before that.
  const LATEST = /(\w+)\.sendMessage!==null&&\((\w+)=(\w+),(\w+)\?\(\1\.sendMessage\(\3\),(\w+)=!1/;
  const FIRST = "$1.sendMessage!==null&&($5&&$2&&$2.uuid!==$3.uuid&&$1.sendMessage($2)," +
    "$2=$3,$4?($1.sendMessage($3),$5=!1";
  document.head.appendChild = (node) => {
    if (node instanceof HTMLScriptElement && node.type === "module") {
      node.textContent = node.textContent.replace(LATEST, FIRST);
      delete document.head.appendChild;
    }
    document.head.append(node);
    return node;
  };

  // viser's worker says when its connection opens and closes.
  const AWAY = "The server is away. What you did is saved; this page goes on once it is back";
  window.Worker = class extends window.Worker {
    constructor(...options) {
      super(...options);
      this.addEventListener("message", ({ data }) => {
        if (data?.type === "connected") window.__artiworld?.set({ away: "" });
        if (data?.type === "closed") window.__artiworld?.set({ away: AWAY });
      });
    }
  };
})();
