"use strict";
// Shows the newest image of a camera on a canvas; one that is old is grey and says its age. Images come one by one on
// the WebSocket /pictures, or as video beside it where the rig offers that; see vision.stereo.transport and webrtc. The
// age counts from when the image was taken, by the rig's clock. Events "picture" of the canvas tell how each one came.
const OLD_MS = 500, AGAIN_MS = 1000, VIDEO_AGAIN_MS = 60000, STRIP = 16, BITS = 24, PARITY = 8;

function ageText(ms) {
  return ms === null ? "no image yet" : ms < 60000 ? (ms / 1000).toFixed(1) + " s old" : Math.round(ms / 60000) + " min old";
}

class CameraView {
  // columns: where the age stands, as fractions of the width; said: gets what came with an image; drawn: is called after
  // each drawing, with the age [ms], null before the first image.
  constructor(canvas, {camera = "", columns = [0.5], said = () => {}, drawn = () => {}} = {}) {
    Object.assign(this, {canvas, columns, said, drawn, pen: canvas.getContext("2d"), shown: 0});
    this.source = this.taken = this.ahead = this.peer = this.coming = null;
    this.videoAt = this.videoTried = -Infinity;
    this.address = location.origin.replace("http", "ws") + "/pictures?camera=" + encodeURIComponent(camera);
    this.strip = Object.assign(document.createElement("canvas"), {width: BITS + PARITY, height: 1});
    this.stripPen = this.strip.getContext("2d", {willReadFrequently: true});
    this.timer = setInterval(() => { if (this.old) this.draw(); }, 200);
    this.connect();
  }

  get age() { return this.taken === null ? null : performance.now() - this.taken; }
  get old() { return this.taken === null || this.age > OLD_MS; }
  get videoRuns() { return performance.now() - this.videoAt < 2 * OLD_MS; }

  close() {
    clearInterval(this.timer);
    this.closed = true;
    this.socket.close();
  }

  connect() {
    const ticket = sessionStorage.getItem("ticket");  // of a page with the code, which keeps its place
    const socket = this.socket = new WebSocket(this.address + (ticket ? "&ticket=" + ticket : ""));
    this.trip = Infinity;
    socket.binaryType = "blob";
    socket.onopen = () => this.ask();
    socket.onclose = () => {
      if (this.peer) this.peer.close();
      this.peer = null;
      if (!this.closed) setTimeout(() => this.connect(), AGAIN_MS);
    };
    socket.onmessage = ({data}) => typeof data === "string" ? this.hear(JSON.parse(data)) : this.decode(data);
  }

  send(message) { if (this.socket.readyState === WebSocket.OPEN) this.socket.send(JSON.stringify(message)); }
  ask() { this.send({t: performance.now(), video: this.videoRuns, age: this.age}); }

  hear(said) {
    const received = performance.now();
    if ("answer" in said) {
      if (said.answer && this.peer) this.peer.setRemoteDescription({type: "answer", sdp: said.answer}).catch(() => {});
      return;
    }
    // The rig's clock is ahead by what the answer says; the sooner it came, the better is that known.
    const trip = received - said.t - said.waited;
    if (trip <= this.trip) {
      this.trip = trip;
      this.ahead = said.now + trip / 2 - received;
    }
    this.trip += 0.1;
    this.said(said);
    if (said.video) this.offer();
    if (said.picture && !this.videoRuns) this.coming = {...said, received};
    else this.ask();
  }

  async decode(blob) {
    const coming = this.coming;
    try {
      const image = await createImageBitmap(blob);
      if (coming) this.take(image, coming.taken - this.ahead, {...coming, decoded: performance.now()});
    } finally {
      this.ask();
    }
  }

  // Shows an image that was taken at a time of the page's clock [ms], unless what is shown is newer: those of the video
  // and others may cross.
  take(source, at, how) {
    const taken = Math.min(at, performance.now());
    if (this.taken !== null && taken < this.taken) return;
    if (this.source && this.source !== source && this.source.close) this.source.close();
    Object.assign(this, {source, taken});
    this.shown += 1;
    this.draw();
    this.canvas.dispatchEvent(new CustomEvent("picture", {detail: {...how, taken, ahead: this.ahead}}));
  }

  draw() {
    const {canvas, pen, source} = this, video = source instanceof HTMLVideoElement;
    if (source) {
      const width = video ? source.videoWidth : source.width, height = video ? source.videoHeight - STRIP : source.height;
      if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, {width, height});
      pen.drawImage(source, 0, 0, width, height, 0, 0, width, height);
    }
    if (this.old) {
      pen.globalCompositeOperation = "saturation";
      pen.fillStyle = "#000";
      pen.fillRect(0, 0, canvas.width, canvas.height);
      pen.globalCompositeOperation = "source-over";
      pen.fillStyle = source ? "rgba(0, 0, 0, 0.5)" : "#000";
      pen.fillRect(0, 0, canvas.width, canvas.height);
      pen.fillStyle = "#ffc83c";
      pen.textAlign = "center";
      pen.font = Math.round(canvas.height / 10) + "px sans-serif";
      for (const column of this.columns) pen.fillText(ageText(this.age), column * canvas.width, canvas.height / 4);
    }
    this.drawn(this.age);
  }

  async offer() {
    if (this.peer || performance.now() - this.videoTried < VIDEO_AGAIN_MS || !window.RTCPeerConnection) return;
    this.videoTried = performance.now();
    const peer = this.peer = new RTCPeerConnection(), video = document.createElement("video");
    Object.assign(video, {muted: true, autoplay: true, playsInline: true});
    if (!video.requestVideoFrameCallback) return;
    const receiver = peer.addTransceiver("video", {direction: "recvonly"}).receiver;
    receiver.jitterBufferTarget = receiver.playoutDelayHint = 0;
    peer.ontrack = ({track}) => {
      video.srcObject = new MediaStream([track]);
      video.play().catch(() => {});
      const frame = (now, about) => {
        video.requestVideoFrameCallback(frame);
        const taken = this.read(video);
        if (taken === null) return;
        this.videoAt = performance.now();
        this.take(video, taken, {received: about.receiveTime, decoded: this.videoAt, decoding: about.processingDuration});
      };
      video.requestVideoFrameCallback(frame);
    };
    peer.onconnectionstatechange = () => { if (peer.connectionState === "failed") this.socket.close(); };
    await peer.setLocalDescription(await peer.createOffer());
    const started = performance.now();
    while (peer.iceGatheringState !== "complete" && performance.now() - started < AGAIN_MS) await new Promise(again => setTimeout(again, 20));
    this.send({offer: peer.localDescription.sdp});
  }

  // Returns when a frame of the video was taken, by the page's clock and its strip; null where that is unreadable.
  read(video) {
    if (this.ahead === null || video.videoHeight <= STRIP) return null;
    const count = BITS + PARITY;
    this.stripPen.imageSmoothingEnabled = false;
    this.stripPen.drawImage(video, 0, video.videoHeight - STRIP / 2, video.videoWidth, 1, 0, 0, count, 1);
    const data = this.stripPen.getImageData(0, 0, count, 1).data, bit = i => +(data[4 * i] > 127);
    for (let i = 0; i < PARITY; i++) if ((bit(i) + bit(i + 8) + bit(i + 16)) % 2 !== bit(BITS + i)) return null;
    let number = 0;
    for (let i = 0; i < BITS; i++) number += bit(i) * 2 ** i;
    const now = performance.now(), range = 2 ** BITS;
    return now - ((now + this.ahead - number) % range + range) % range;
  }
}
