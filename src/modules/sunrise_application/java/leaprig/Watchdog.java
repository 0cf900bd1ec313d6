package leaprig;

/** Judges the silence of a client; the time is handed in, in seconds. */
final class Watchdog {
    enum Verdict { ALIVE, BRAKE, END }

    static final double BRAKE_LEAST = 0.05;
    static final double BRAKE_MOST = 2;
    static final double END_MOST = 60;
    private volatile double brake;
    private volatile double end;

    Watchdog() { reset(); }

    /** The times that a new client has. */
    void reset() {
        brake = 0.2;
        end = 10;
    }

    double brake() { return brake; }

    double end() { return end; }

    /** Sets both times; returns why not, or null. */
    String set(double brakeAfter, double endAfter) {
        if (!(brakeAfter >= BRAKE_LEAST && brakeAfter <= BRAKE_MOST))
            return "the first time is " + brakeAfter + " s, but must be " + BRAKE_LEAST + " to " + BRAKE_MOST;
        if (!(endAfter > brakeAfter && endAfter <= END_MOST))
            return "the second time is " + endAfter + " s, but must be above the first and at most " + END_MOST;
        brake = brakeAfter;
        end = endAfter;
        return null;
    }

    Verdict judge(double silence) {
        return silence > end ? Verdict.END : silence > brake ? Verdict.BRAKE : Verdict.ALIVE;
    }
}
