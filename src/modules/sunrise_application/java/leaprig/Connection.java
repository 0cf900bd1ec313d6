package leaprig;

import java.io.IOException;
import java.io.InputStream;
import java.net.Socket;
import java.util.concurrent.LinkedBlockingQueue;
import java.util.concurrent.TimeUnit;

/**
 * One connection: a thread that reads lines and one that writes answers, so that neither a client that does not read
 * nor one that does not write keeps the arm's thread. Until its first known word it is nobody's.
 */
final class Connection implements Session.Out {
    private enum Role { NEW, CLIENT, CHANNEL }

    private static final int UNKNOWN_FOR = 60000;
    private static final int OPEN_ANSWERS = 1000;
    private static final int CHANGE_TRIES = 400;
    private static final String CLOSE = "";
    private final Network network;
    private final Session session;
    private final Session.Log log;
    private final Socket socket;
    private final String name;
    private final LinkedBlockingQueue<String> answers = new LinkedBlockingQueue<String>(OPEN_ANSWERS);
    private final Request request = new Request();
    private final Lines lines = new Lines();
    private volatile boolean closing;
    private Role role = Role.NEW;

    Connection(Network network, Session session, Session.Log log, Socket socket) throws IOException {
        this.network = network;
        this.session = session;
        this.log = log;
        this.socket = socket;
        name = socket.getInetAddress().getHostAddress() + ":" + socket.getPort();
        socket.setTcpNoDelay(true);
        socket.setSoTimeout(UNKNOWN_FOR);
    }

    void start() {
        thread("reader of " + name, new Runnable() {
            @Override
            public void run() { read(); }
        });
        thread("writer to " + name, new Runnable() {
            @Override
            public void run() { write(); }
        });
    }

    private static void thread(String name, Runnable task) {
        Thread thread = new Thread(task, name);
        thread.setDaemon(true);
        thread.start();
    }

    private void read() {
        byte[] bytes = new byte[4096];
        try {
            InputStream in = socket.getInputStream();
            while (!closing) {
                int count = in.read(bytes);
                if (count < 0) break;
                for (int i = 0; i < count && !closing; i++) {
                    String line = lines.take(bytes[i]);
                    if (line != null) take(line);
                }
            }
        } catch (IOException error) {
            if (!closing) log.info(name + ": " + error.getMessage());
        } catch (RuntimeException error) {
            log.info(name + " is closed, as its line failed: " + error);
        }
        if (role == Role.CLIENT) session.leave(this);
        if (role == Role.CHANNEL) session.leaveChannel(this);
        close();
    }

    private void take(String line) throws IOException {
        request.read(line);
        if (role == Role.NEW && request.word != null) {
            if (request.word == Word.STOP) {
                session.stop();
                send(Text.ok(Word.STOP));
                return;
            }
            if (request.word == Word.CHANNEL) {
                String answer = session.join(request, this);
                if (answer.startsWith("ok")) become(Role.CHANNEL);
                send(answer);
                return;
            }
            if (!admitted()) return;
        }
        if (role == Role.CLIENT) send(session.receive(request, this, Network.now()));
        else if (role == Role.CHANNEL) send(session.second(request));
    }

    private boolean admitted() throws IOException {
        String holder = session.admit(name, this, network.number(), Network.now());
        for (int i = 0; i < CHANGE_TRIES && holder != null && session.changing(); i++) {
            Network.pause(5);
            holder = session.admit(name, this, network.number(), Network.now());
        }
        if (holder == null) {
            become(Role.CLIENT);
            return true;
        }
        log.info(name + " is told that " + holder + " holds the arm");
        send("busy_" + Text.plain(holder) + "_\n");
        close();
        return false;
    }

    private void become(Role now) throws IOException {
        role = now;
        socket.setSoTimeout(0);
    }

    private void write() {
        try {
            while (true) {
                String text = answers.poll(1, TimeUnit.SECONDS);
                if (text == null && !closing) continue;
                if (text == null || text == CLOSE) break;
                socket.getOutputStream().write(text.getBytes("US-ASCII"));
            }
        } catch (IOException error) {
            if (!closing) log.info(name + ": " + error.getMessage());
        } catch (InterruptedException error) {
            Thread.currentThread().interrupt();
        }
        closing = true;
        network.gone(this);
        try {
            socket.close();
        } catch (IOException error) {
            log.info(name + " does not close: " + error.getMessage());
        }
    }

    /** A client that leaves a thousand answers unread is closed. */
    @Override
    public void send(String text) {
        if (text != null && !closing && !answers.offer(text)) {
            log.info(name + " reads no answers and is closed");
            shut();
        }
    }

    /** Closes it when what was said is written. */
    @Override
    public void close() {
        if (closing) return;
        closing = true;
        if (!answers.offer(CLOSE)) shut();
    }

    private void shut() {
        closing = true;
        try {
            socket.close();
        } catch (IOException error) {
            log.info(name + " does not close: " + error.getMessage());
        }
    }
}
