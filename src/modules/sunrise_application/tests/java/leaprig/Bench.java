package leaprig;

import java.util.ArrayList;
import java.util.List;

/** A session, its client and its arm, in time that is handed in. */
final class Bench {
    static final double CYCLE = 0.001;
    final FakeArm arm = new FakeArm();
    final List<String> log = new ArrayList<String>();
    final Session session;
    final Line client = new Line();
    final Line second = new Line();
    private final Request request = new Request();
    double now = 10;

    /** What was sent to one connection. */
    static final class Line implements Session.Out {
        final StringBuilder said = new StringBuilder();
        boolean closed;

        @Override
        public void send(String text) {
            if (text != null) said.append(text);
        }

        @Override
        public void close() { closed = true; }

        String take() {
            String all = said.toString();
            said.setLength(0);
            return all;
        }
    }

    Bench() {
        session = new Session(arm, new Session.Log() {
            @Override
            public void info(String sentence) { log.add(sentence); }
        }, new Watchdog());
        check(session.admit("client", client, 123456, now) == null, "the first client is admitted");
    }

    /** Sends a line, lets the main thread answer, returns all that came. */
    String ask(String line) {
        request.read(line);
        client.send(session.receive(request, client, now));
        run(2 * CYCLE);
        return client.take();
    }

    String second(String line) {
        request.read(line);
        String answer = session.second(request);
        return answer;
    }

    void hello() { check(ask("lrHello_1_").startsWith("ok_lrHello_leapRig_1_123456_"), "hello"); }

    void join() {
        request.read("lrChannel_123456_");
        check(session.join(request, second).equals("ok_lrChannel_123456.0_\n"), "join");
    }

    void run(double seconds) {
        double until = now + seconds;
        while (now < until) {
            now += CYCLE;
            arm.now = now;
            session.cycle(now);
        }
    }

    /** The same while the client says that it lives. */
    void live(double seconds) {
        for (double left = seconds; left > 0; left -= 0.05) {
            request.read("lrBeat_");
            session.receive(request, client, now);
            run(Math.min(left, 0.05));
        }
    }

    static void check(boolean holds, String what) {
        if (!holds) throw new AssertionError(what);
    }

    static void equal(Object expected, Object found) {
        if (!expected.equals(found)) throw new AssertionError("expected " + expected + ", found " + found);
    }
}
