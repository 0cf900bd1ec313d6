package com.kuka.roboticsAPI.applicationModel;

import com.kuka.roboticsAPI.deviceModel.LBR;
import com.kuka.roboticsAPI.motionModel.IErrorHandler;

public abstract class RoboticsAPIApplication {
    public static final class Log {
        private static void line(String level, String s) {
            System.out.printf("%.3f %s %s%n", System.currentTimeMillis() / 1000.0, level, s);
            System.out.flush();
        }

        public void info(String s) { line("INFO", s); }

        public void warn(String s) { line("WARN", s); }

        public void error(String s) { line("ERROR", s); }
    }

    public static final class Context {
        private final LBR lbr = new LBR();

        public <T> T getDeviceFromType(Class<T> type) { return type.cast(lbr); }
    }

    private final Log log = new Log();
    private final Context context = new Context();

    public Log getLogger() { return log; }

    public Context getContext() { return context; }

    public IApplicationControl getApplicationControl() {
        return new IApplicationControl() {
            @Override
            public void registerMoveAsyncErrorHandler(IErrorHandler handler) { }
        };
    }

    public void initialize() throws Exception { }

    public abstract void run() throws Exception;

    public void runApplication() {
        try {
            initialize();
            run();
            log.info("application ended");
        } catch (Exception e) {
            log.error("application died: " + e);
        }
        // On a controller the virtual machine outlives the application, and so does the reader thread: sim.linger keeps it.
        if (Boolean.getBoolean("sim.linger")) com.kuka.common.ThreadUtil.milliSleep(Long.MAX_VALUE);
        System.exit(0);
    }
}
