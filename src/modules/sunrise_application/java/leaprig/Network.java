package leaprig;

import java.io.Closeable;
import java.io.IOException;
import java.net.InetSocketAddress;
import java.net.ServerSocket;
import java.net.Socket;
import java.security.SecureRandom;
import java.util.HashSet;
import java.util.Set;

/** Listens, and gives each connection its threads, which talk to the session. */
final class Network implements Closeable {
    private static final int MOST = 12;
    private static final double PACE = Double.parseDouble(System.getProperty("leaprig.pace", "1"));
    private final Session session;
    private final Session.Log log;
    private final ServerSocket listener = new ServerSocket();
    private final Set<Connection> connections = new HashSet<Connection>();
    private final SecureRandom random = new SecureRandom();
    private volatile boolean closed;

    /** Without a host it listens on every interface; port 0 takes any free one. */
    Network(Session session, Session.Log log, String host, int port) throws IOException {
        this.session = session;
        this.log = log;
        listener.setReuseAddress(true);
        listener.bind(host == null ? new InetSocketAddress(port) : new InetSocketAddress(host, port));
    }

    int port() { return listener.getLocalPort(); }

    void start() {
        Thread thread = new Thread("accept") {
            @Override
            public void run() {
                while (!closed) accept();
            }
        };
        thread.setDaemon(true);
        thread.start();
    }

    private void accept() {
        try {
            Socket socket = listener.accept();
            synchronized (connections) {
                if (connections.size() < MOST) {
                    Connection made = new Connection(this, session, log, socket);
                    connections.add(made);
                    made.start();
                    return;
                }
            }
            log.info("more than " + MOST + " connections: " + socket.getInetAddress() + " is turned away");
            socket.close();
        } catch (IOException error) {
            if (!closed) {
                log.info("no connection could be accepted: " + error);
                pause(100);
            }
        }
    }

    void gone(Connection connection) {
        synchronized (connections) {
            connections.remove(connection);
        }
    }

    /** A number that a second connection names to join the first. */
    int number() { return 100000 + random.nextInt(900000); }

    static double now() { return PACE * 1e-9 * System.nanoTime(); }

    static void pause(long milliseconds) {
        try {
            Thread.sleep(milliseconds);
        } catch (InterruptedException e) {
            Thread.currentThread().interrupt();
        }
    }

    @Override
    public void close() throws IOException {
        closed = true;
        listener.close();
        synchronized (connections) {
            for (Connection each : connections) each.close();
        }
    }
}
