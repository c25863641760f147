/* Search on pages that are opened from the disk: browsers refuse a Worker there. This runs the
   search's script in a frame instead, in the same way as a Worker is used. */
if (location.protocol === "file:") {
  window.Worker = class extends EventTarget {
    constructor(url) {
      super();
      this.frame = document.createElement("iframe");
      this.frame.hidden = true;
      document.body.appendChild(this.frame);
      const inside = this.frame.contentWindow;
      window.addEventListener("message", (event) => {
        if (event.source !== inside) return;
        const told = new MessageEvent("message", { data: event.data });
        this.dispatchEvent(told);
        if (this.onmessage) this.onmessage(told);
      });
      inside.document.open();
      inside.document.write(`<!doctype html><script>
        postMessage = (data) => parent.dispatchEvent(
          new MessageEvent("message", { data, source: window }));
        importScripts = (...urls) => urls.reduce((before, url) => before.then(() =>
          new Promise((done, failed) => {
            const script = document.createElement("script");
            script.src = url;
            script.onload = done;
            script.onerror = failed;
            document.body.appendChild(script);
          })), Promise.resolve());
        </` + `script><body><script src="${new URL(url, location.href)}"></` + `script>`);
      inside.document.close();
      this.loaded = new Promise((done) => this.frame.addEventListener("load", done));
    }
    postMessage(data) {
      const inside = this.frame.contentWindow;
      const send = () => inside.dispatchEvent(new MessageEvent("message", { data }));
      if (inside.document.readyState === "complete") send();
      else this.loaded.then(send);
    }
    terminate() {
      this.frame.remove();
    }
  };
}
