package leaprig;

import com.kuka.common.ThreadUtil;
import com.kuka.roboticsAPI.applicationModel.RoboticsAPIApplication;
import com.kuka.roboticsAPI.deviceModel.Device;
import com.kuka.roboticsAPI.deviceModel.LBR;
import com.kuka.roboticsAPI.motionModel.ErrorHandlingAction;
import com.kuka.roboticsAPI.motionModel.IErrorHandler;
import com.kuka.roboticsAPI.motionModel.IMotionContainer;
import java.io.IOException;
import java.util.List;

/** The robot application: start it on the smartPad; it serves one client after another until it is ended there. */
public class LeapRigServer extends RoboticsAPIApplication {
    private static final int PORT = 30001;
    private LBR lbr;

    @Override
    public void initialize() { lbr = getContext().getDeviceFromType(LBR.class); }

    @Override
    public void run() throws IOException {
        Session.Log log = new Session.Log() {
            @Override
            public void info(String sentence) { getLogger().info(sentence); }
        };
        getApplicationControl().registerMoveAsyncErrorHandler(new IErrorHandler() {
            @Override
            public ErrorHandlingAction handleError(Device device, IMotionContainer failed, List<IMotionContainer> cancelled) {
                getLogger().warn("the controller gave a motion up: " + failed.getErrorMessage());
                return ErrorHandlingAction.Ignore;
            }
        });
        Session session = new Session(new SunriseArm(lbr), log, new Watchdog());
        // Tests set both, and the pace of the clock; on a cabinet they are unset.
        String host = System.getProperty("leaprig.host");
        Network network = new Network(session, log, host, Integer.getInteger("leaprig.port", PORT));
        log.info("listening on port " + network.port());
        network.start();
        try {
            while (!Thread.currentThread().isInterrupted()) {
                session.cycle(Network.now());
                ThreadUtil.milliSleep(1);
            }
        } finally {
            network.close();
        }
    }

    public static void main(String[] arguments) { new LeapRigServer().runApplication(); }
}
