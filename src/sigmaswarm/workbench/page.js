// Keep the keyboard focus: if an element was replaced, focus the new element with the same name.
(() => {
  let last = null, name = "";
  const named = (e) => (e.closest("[role=slider]") || e).getAttribute("aria-label") || (e.closest("label") || e).innerText;
  document.addEventListener("focusin", (e) => { last = e.target; name = named(last); });
  const restore = () => {
    for (const input of document.querySelectorAll(".drop a.q-btn input:not([inert])")) {
      input.inert = true; // the button around the input opens the file dialog
      input.closest("a").setAttribute("aria-label", "Choose the files of a log");
    }
    if (!last || last.isConnected || document.activeElement !== document.body || !name) return;
    const same = [...document.querySelectorAll(last.tagName)].find((e) => named(e) === name && !e.disabled);
    if (same) same.focus({ preventScroll: true });
  };
  new MutationObserver(restore).observe(document.documentElement, { childList: true, subtree: true });

  // Read a dropped folder here, since a browser passes only single files to an uploader.
  window.droppedFolders = new Set();
  let nameOfDrop = "";
  window.nameOfDrop = () => { const name = nameOfDrop; nameOfDrop = ""; return name; };
  const filesOf = async (entry) => {
    if (entry.isFile) return [await new Promise((done, failed) => entry.file(done, failed))];
    const reader = entry.createReader(), found = [];
    for (;;) {
      const some = await new Promise((done, failed) => reader.readEntries(done, failed));
      if (!some.length) break;
      found.push(...some.filter((e) => e.isFile && !e.name.startsWith(".")));
    }
    return (await Promise.all(found.map(filesOf))).flat();
  };
  document.addEventListener("drop", async (e) => {
    const box = e.target.closest && e.target.closest(".drop");
    if (!box) return;
    const folders = [...e.dataTransfer.items].map((i) => i.webkitGetAsEntry()).filter((i) => i && i.isDirectory);
    folders.forEach((folder) => window.droppedFolders.add(folder.name));
    const files = (await Promise.all(folders.map(filesOf))).flat();
    nameOfDrop = folders.length && files.length > 1 ? folders[0].name : "";
    if (files.length) getElement(Number(box.id.slice(1))).$refs.qRef.addFiles(files);
  }, true);
})();
